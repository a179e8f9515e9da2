"""What all packages stand on: the C library, arguments, errors, callbacks, optional packages."""

from . import arguments, extras, files, pointers
from .arguments import Array
from .callbacks import (
    FUNCTIONS,
    Callables,
    Observer,
    ignore,
    watching,
)
from .errors import (
    ConvergenceError,
    DalembertError,
    DalembertWarning,
    DomainError,
    NotOnConstraintError,
    SingularError,
    adopt,
    attempt,
    check,
    failure,
    make,
    words,
)
from .handle import (
    KINDS,
    MISSING,
    MISSING_PHI_Q,
    Handle,
    Workspaces,
    differenced,
    require_system,
)
from .library import (
    ROUNDOFF,
    Constant,
    doubles,
    ffi,
    lib,
    pointer,
    residual_bound,
    string,
    strings,
    version,
)
