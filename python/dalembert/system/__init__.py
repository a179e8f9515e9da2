"""The systems that users make."""

from .system import System
