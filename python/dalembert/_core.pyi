"""The extension that cffi makes from ``dalembert.h``; its contents are made when it is built."""

from typing import Any

ffi: Any
lib: Any
