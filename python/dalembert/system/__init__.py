"""The systems that users make, and where they come from."""

from .sources import BuiltIn, Expressions
from .system import System, require_parameters
