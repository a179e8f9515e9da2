"""The common basis: the C library, arguments, errors, callbacks, optional packages."""

from . import arguments, extras, files, functions, pointers
from .arguments import Array, Pair
from .callbacks import (
    Callables,
    ignore,
    watching,
)
from .errors import (
    ConvergenceError,
    DalembertError,
    DalembertWarning,
    DomainError,
    JournalError,
    NotOnConstraintError,
    SingularError,
    ZenoError,
    attempt,
    call,
    check,
    failure,
    make,
    words,
)
from .handle import (
    KINDS,
    Handle,
    Workspaces,
    first,
    require_autonomous,
    require_system,
)
from .library import (
    ROUNDOFF,
    Constant,
    doubles,
    ffi,
    lib,
    members,
    pointer,
    residual_bound,
    string,
    strings,
    version,
)
