"""Systems defined by users, and their sources."""

from .sources import BuiltIn, Expressions
from .system import System, require_parameters
