"""Compilation of generated C, and the cache of compiled models.

The compiler is ``$CC``, else the first of cc, gcc and clang.  The cache is ``$DALEMBERT_CACHE``,
else ``$XDG_CACHE_HOME/dalembert``, else ``~/.cache/dalembert``.  It has one file, with the C beside
it, for each model, version of the package and of SymPy, compiler and flags.  The flags in
``$DALEMBERT_CFLAGS`` come after its own: ``-O1`` compiles faster, and the programs are slower.

A file is written under a temporary name and renamed, so several processes may write the same file
at once.  It ends with a digest of itself, so truncated and foreign files are compiled again.  It is
loaded only if no other user could have written it.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import hashlib
import importlib.resources
import logging
import math
import os
import platform
import re
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from . import core
from .core import DalembertError, DalembertWarning, extras, files

__all__ = ["Compiler", "CompilerError", "Library", "clear", "entries", "find", "folder", "library"]


def _for_processor() -> tuple[str, ...]:
    """Return the flags for this processor; they are part of the key in the cache.

    AVX has instructions with three operands, which save a sixth of the instructions of a step.  It
    has no fused operations with a single rounding, so the bits are the same.
    """
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            flags = next((line for line in file if line.startswith("flags")), "")
    except OSError:
        return ()
    return ("-mavx2",) if "avx2" in flags.split() else ()


# Measured: -O3 makes the fastest step, without vectorisation, which packs what was just stored, and
# without three passes that take a third of the time of compiling.  Contraction would change bits.
COMMON = ("-std=c11", "-O3", "-fno-tree-vectorize", "-fno-gcse", "-fno-gcse-after-reload",
          "-fno-schedule-insns2", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-shared",
          "-Werror=implicit-function-declaration",
          *shlex.split(os.environ.get("DALEMBERT_CFLAGS", "")))  # fmt: skip
FLAGS = (*COMMON, *_for_processor())

# With lanes a program has parts for each processor, and what they share is for all of them.
_LIBMVEC = (("v_sin", "v_cos", "v_exp", "v_log", "vv_pow"), ("v_tan", "v_erf", "vv_atan2"))

HEADERS = (
    "arrays.h", "dalembert.h", "field.h", "kernel.h", "lanes.h", "lu.h", "momentum.h", "residual.h",
    "rows.h", "series.h", "stage.h", "stepper.h",
)  # fmt: skip

# Seconds after which a compiler is taken to hang; a large model takes some.
LIMIT = 600.0

_log = logging.getLogger(__name__)
_progress: ContextVar[extras.Progress | None] = ContextVar("progress", default=None)

_PLACE = "dalembert-compiles-"  # begins the names of the directories in which compilers run

_MARK = b"dalembert compiled this"


class CompilerError(DalembertError):
    """The C compiler rejected a generated program, or could not be executed."""


# ---- the compiler ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Compiler:
    """A C compiler: the command that runs it, and a text that identifies it and its version."""

    command: tuple[str, ...]
    identity: str


def find() -> Compiler | None:
    """Return the C compiler, or None if there is none."""
    wanted = os.environ.get("CC", "")
    for candidate in [shlex.split(wanted)] if wanted.strip() else [["cc"], ["gcc"], ["clang"]]:
        path = shutil.which(candidate[0])
        if path is not None:
            real = os.path.realpath(path)
            about = os.stat(real)
            identity = f"{real} {about.st_size} {about.st_mtime_ns} {candidate[1:]}"
            return Compiler((path, *candidate[1:]), identity)
    return None


def _flags_for_lanes(compiler: Compiler) -> tuple[str, ...]:
    """Return the flags of a program with lanes, which declare the available parts of libmvec.

    The library belongs to libm; its functions appeared in glibc 2.22 and 2.35.  The compiler tries
    some of them.
    """
    if platform.machine() != "x86_64":
        return COMMON
    for version in (2, 1):
        functions = [name for names in _LIBMVEC[:version] for name in names]
        names = [f"_ZGV{x}{name}" for name in functions for x in ("bN2", "dN4", "eN8")]
        tried = "".join(f"void {x}(void);\n" for x in names)
        tried += "void all(void);\nvoid all(void) { " + " ".join(f"{x}();" for x in names) + " }\n"
        with tempfile.TemporaryDirectory(prefix=_PLACE) as directory:
            root = Path(directory)
            (root / "tried.c").write_text(tried)
            command = [*compiler.command, "-fPIC", "-shared", "-Wl,-z,defs", "tried.c"]
            status, _ = _run([*command, "-o", "tried.so", "-lm"], root)
        if status == 0:
            return (*COMMON, f"-DDAL_LANES_LIBMVEC={version}")
    return COMMON


def compile_program(
    compiler: Compiler, source: str, lanes: bool = False, tick: Callable[[], None] = lambda: None
) -> bytes:
    """Return the shared library compiled from a source; ``tick`` is called now and then.

    A CompilerError has the line of C that the compiler rejects.
    """
    _remove_left()
    flags = _flags_for_lanes(compiler) if lanes else FLAGS
    with tempfile.TemporaryDirectory(prefix=_PLACE) as directory:
        root = Path(directory)
        (root / "dalembert").mkdir()
        for name, text in _headers().items():
            (root / ("" if name == "dalembert.h" else "dalembert") / name).write_text(text)
        (root / "model.c").write_text(source, encoding="ascii")
        command = [*compiler.command, *flags, "-I.", "model.c", "-o", "model.so", "-lm"]
        status, printed = _run(command, root, tick)
        if status != 0 or not (root / "model.so").exists():
            raise CompilerError(_explain(command, source, printed))
        return (root / "model.so").read_bytes()


def _run(
    command: list[str], root: Path, tick: Callable[[], None] = lambda: None
) -> tuple[int, str]:
    """Run a compiler in a directory; return its status and its output.

    It leads a group of processes that is ended with it, also after the time limit or Ctrl-C.
    """
    try:
        process = subprocess.Popen(
            command, cwd=root, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise CompilerError(f"{shlex.join(command)}: {error}") from error
    end = time.monotonic() + LIMIT
    with process:
        try:
            printed = None
            while printed is None:
                with contextlib.suppress(*[subprocess.TimeoutExpired] * (time.monotonic() < end)):
                    _, printed = process.communicate(timeout=0.2)
                tick()
        except BaseException as error:
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                text = f"the C compiler did not finish in {LIMIT:g} s: {shlex.join(command)}"
                raise CompilerError(text) from None
            raise
    return process.returncode, printed


def _remove_left() -> None:
    """Remove old directories of our own compilers whose process was killed."""
    for path in Path(tempfile.gettempdir()).glob(f"{_PLACE}*"):
        with contextlib.suppress(OSError):
            about = path.lstat()
            old = about.st_mtime < time.time() - 2 * LIMIT
            if old and stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid():
                shutil.rmtree(path)


def _explain(command: list[str], source: str, printed: str) -> str:
    """Return the compiler's error message in terms of the model."""
    lines = [f"the C compiler failed on a generated program: {shlex.join(command)}"]
    found = re.search(r"^model\.c:(\d+):.*error:\s*(.*)$", printed, flags=re.M)
    if found is None:
        return "\n".join([*lines, printed.strip() or "it said nothing"])
    number = int(found[1])
    text = source.split("\n")[number - 1].strip()
    lines += [f"line {number}: {found[2]}", f"  {text[:1000]}"]
    return "\n".join(lines)


@functools.cache
def _headers() -> dict[str, str]:
    """Return the headers of the library, which are package data."""
    place = importlib.resources.files(__package__).joinpath("include")
    return {name: place.joinpath(name).read_text(encoding="utf-8") for name in HEADERS}


@functools.cache
def _generator() -> str:
    """Return a digest of all inputs of a compilation: this module, headers, library and flags."""
    digest = hashlib.sha256(repr((core.version(), FLAGS, platform.machine())).encode())
    digest.update(Path(__file__).read_bytes())
    for name, text in _headers().items():
        digest.update(f"{name}\n{text}".encode())
    return digest.hexdigest()


# ---- the cache ---------------------------------------------------------------------------------


def folder() -> Path:
    """Return the folder of the cache of compiled models.

    Examples
    --------
    >>> from dalembert import compiler
    >>> compiler.folder().is_absolute()
    True
    """
    if own := os.environ.get("DALEMBERT_CACHE"):
        return Path(own).absolute()
    base = os.environ.get("XDG_CACHE_HOME", "")
    # the rule of XDG: a path that is not absolute is ignored
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "dalembert"


def entries() -> list[Path]:
    """Return the compiled models in the cache, the largest first.

    Examples
    --------
    >>> from dalembert import compiler
    >>> all(path.suffix == ".so" for path in compiler.entries())
    True
    """
    try:
        found = [p for p in folder().iterdir() if re.fullmatch(r"[0-9a-f]{64}\.so", p.name)]
        return sorted(found, key=lambda path: (-path.stat().st_size, path.name))
    except OSError:
        return []


def clear() -> int:
    """Remove all compiled models, and return their number."""
    found = entries()
    left = folder().glob("*.new")  # of a process that was killed
    for path in (*found, *(path.with_suffix(".c") for path in found), *left):
        path.unlink(missing_ok=True)
    return len(found)


def _sealed(content: bytes, key: str) -> bytes:
    """Return a library with a digest of itself appended, which the loader ignores."""
    return content + _MARK + hashlib.sha256(content + key.encode()).digest()


def _is_sound(path: Path, key: str) -> bool:
    """Return whether a file is a complete library for this key that only the user can write."""
    _require_private(path)
    content = path.read_bytes()
    body = content[: -len(_MARK) - 32]
    return content == _sealed(body, key)


def _require_private(path: Path) -> None:
    """Raise OSError unless only the user can write to a file or directory that will be executed."""
    about = path.stat()
    if about.st_uid != os.getuid() or stat.S_IMODE(about.st_mode) & 0o022:
        raise PermissionError(f"{path}: other users can write to it")


def _store(directory: Path, key: str, source: str, content: bytes) -> Path:
    """Write a library and its source completely or not at all; OSError if that fails."""
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    _require_private(directory)
    path = directory / f"{key}.so"
    files.replace(path.with_suffix(".c"), source.encode(), 0o600)
    files.replace(path, _sealed(content, key), 0o700)
    return path


@functools.cache
def _private_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a directory of this process, used if the cache cannot be written."""
    return tempfile.TemporaryDirectory(prefix="dalembert-")


# ---- while it takes long ------------------------------------------------------------------------


@contextlib.contextmanager
def showing(progress: extras.Progress | None) -> Iterator[None]:
    """Show the progress of compiling in this way; None: a bar in a terminal."""
    token = _progress.set(progress)
    try:
        yield
    finally:
        _progress.reset(token)


@contextlib.contextmanager
def _waiting(begin: float, size: int) -> Iterator[Callable[[], None]]:
    """Provide a function that shows the seconds since the beginning, if these are more than one.

    A line in the log has the size of the program in C, and the time that one of this size took.
    """
    show: extras.Show | None = None
    before: float | None = None
    with contextlib.ExitStack() as stack:

        def tick() -> None:
            nonlocal show, before
            seconds = time.monotonic() - begin
            if seconds < 1.0:
                return
            if show is None:
                before = _seconds_before(size)
                last = f"; the last one of this size took {before:.0f} s" if before else ""
                doing = f"compiling a model of {size // 1000} kB of C{last}"
                _log.info(doing)
                wanted = _progress.get()
                if wanted is None:
                    wanted = sys.stderr.isatty() and extras.is_there("tqdm")
                show = stack.enter_context(extras.progress(wanted, before, "s", doing))
            show(seconds, max(before or 0.0, seconds))

        yield tick


def _seconds_before(size: int) -> float | None:
    """Return the time that the compiled model took whose program is nearest in size."""
    best, seconds = 0.5, None  # of the logarithm
    for path in entries():
        with contextlib.suppress(OSError):
            text = path.with_suffix(".c").read_text("ascii")
            found = re.search(r"compiled in (\S+) s", text[-50:])
            if found and (distance := abs(math.log(len(text) / size))) < best:
                best, seconds = distance, float(found[1])
    return seconds


# ---- libraries ---------------------------------------------------------------------------------


class Library:
    """A compiled model, loaded from a file.

    ``definition`` is a ``dal_system_def *``: the part that does not depend on parameters.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._loaded = ctypes.CDLL(str(path))
        address = ctypes.addressof(ctypes.c_char.in_dll(self._loaded, "dal_model"))
        self.definition = core.ffi.cast("dal_system_def *", address)

    def has(self, name: str) -> bool:
        """Return whether there is a function ``dal_model_NAME`` of the parameters."""
        return hasattr(self._loaded, f"dal_model_{name}")

    def address(self, name: str) -> int:
        """Return the address of the data ``dal_model_NAME``, 0 if there are none."""
        if not hasattr(self._loaded, f"dal_model_{name}"):
            return 0
        return ctypes.addressof(ctypes.c_char.in_dll(self._loaded, f"dal_model_{name}"))

    def evaluate(self, name: str, parameters: core.Array, output: core.Array) -> None:
        """Call ``dal_model_NAME(output, parameters)``."""
        function = getattr(self._loaded, f"dal_model_{name}")
        function.restype = None
        function(ctypes.c_void_p(output.ctypes.data), ctypes.c_void_p(parameters.ctypes.data))


_libraries: weakref.WeakValueDictionary[str, Library] = weakref.WeakValueDictionary()


def library(
    key: str, versions: str, program: Callable[[], str], lanes: bool = False
) -> Library | None:
    """Return the library of a model, from the cache or compiled; None without a compiler.

    ``key`` is a digest of the model, ``versions`` are those of the code that generates programs.
    ``program()`` returns the source; it is called if the library has to be compiled.  A library
    with ``lanes`` is for all processors.  Raises CompilerError if the compiler rejects the
    program.
    """
    compiler = find()
    if compiler is None:
        return None
    parts = (key, versions, _generator(), compiler.identity, "lanes" * lanes)
    key = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    found = _libraries.get(key)
    if found is None:  # two threads may find the same: either is as good
        found = _libraries[key] = _load_or_compile(compiler, key, program, lanes)
    return found


def _load_or_compile(
    compiler: Compiler, key: str, program: Callable[[], str], lanes: bool
) -> Library:
    """Load a library from the cache, or compile it and store it there."""
    path = folder() / f"{key}.so"
    found = _load(path, key)
    if found is not None:
        return found
    with _alone(path):  # of several processes that want the same one compiles
        found = _load(path, key)
        return _compile(compiler, key, program, lanes) if found is None else found


def _load(path: Path, key: str) -> Library | None:
    """Return a library of the cache; None if it is missing or not trustworthy."""
    try:
        _require_private(path.parent)
        return Library(path) if _is_sound(path, key) else None
    except OSError:  # not there; or what others can write, or the loader refuses: made again
        return None


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Wait while another process compiles the same file, if locks are available."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            name = path.with_suffix(".lock")
            lock = stack.enter_context(open(name, "w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
            stack.callback(name.unlink, missing_ok=True)  # who waits for it finds what was made
        yield


def _compile(
    compiler: Compiler, key: str, program: Callable[[], str], lanes: bool
) -> Library:
    """Compile a library, and store it in the cache, with the time that it took."""
    path = folder() / f"{key}.so"
    begin = time.monotonic()
    source = program()
    with _waiting(begin, len(source)) as tick:
        content = compile_program(compiler, source, lanes, tick)
    source += f"/* compiled in {time.monotonic() - begin:.3g} s */\n"
    try:
        return Library(_store(path.parent, key, source, content))
    except OSError as error:
        warnings.warn(
            f"compiled models cannot be stored in {path.parent} ({error}), so the next "
            "process will compile them again; set DALEMBERT_CACHE to a folder that can be "
            "written",
            DalembertWarning,
            stacklevel=2,
        )
        return Library(_store(Path(_private_folder().name), key, source, content))
