"""Files that are written completely or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path


def require_writable(path: str | Path) -> None:
    """Raise OSError, with the name of the file, if `write` would fail; change nothing."""
    target = Path(path)
    if target.is_dir():
        raise OSError(errno.EISDIR, "this is a folder; expected the name of a file", str(target))
    if _is_device(target):
        return
    if not target.parent.is_dir():
        raise OSError(errno.ENOENT, f"there is no folder {target.parent}", str(target))
    with _naming(target):
        tempfile.TemporaryFile(dir=target.resolve().parent).close()


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Add the name of this file to an OSError."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def require_folder(path: str | Path) -> None:
    """Raise OSError, with the name of the folder, if files in it could not be written."""
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise OSError(errno.ENOTDIR, "this is a file; expected the name of a folder", str(folder))
    with _naming(folder):
        require_writable((folder if folder.is_dir() else folder.parent) / "index.html")


def write(path: str | Path, text: str) -> None:
    """Write a text file; an existing file is replaced when the new one is complete.

    An OSError has the name of the file; an existing file is then unchanged.
    """
    target = Path(path)
    require_writable(target)
    with _naming(target):
        if _is_device(target):
            target.write_text(text, encoding="utf-8")
        else:
            replace(target.resolve(), text.encode())


@contextlib.contextmanager
def _draft(target: Path, content: bytes | memoryview) -> Iterator[Path]:
    """Provide a file with this content beside a target, on the disk; remove it if it remains."""
    draft = target.with_name(f".{target.name[:64]}.{secrets.token_hex(8)}.new")
    try:
        with open(draft, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        yield draft
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()


def replace(target: Path, content: bytes | memoryview, mode: int | None = None) -> None:
    """Write a file under a temporary name, with the given permissions, and rename it."""
    with _draft(target, content) as draft:
        if mode is not None:
            draft.chmod(mode)
        elif target.exists():
            shutil.copymode(target, draft)
        os.replace(draft, target)


def create(target: Path, content: bytes) -> None:
    """Write a new file under a temporary name, and rename it; FileExistsError if it exists."""
    with _draft(target, content) as draft:
        os.link(draft, target)


def is_draft(path: Path) -> bool:
    """Return whether a file is a temporary one of `replace`, or the remains of a killed process."""
    return path.name.startswith(".") and path.suffix == ".new"


def _is_device(target: Path) -> bool:
    """Return whether this is a pipe, a terminal or a similar device, which cannot be replaced."""
    return target.exists() and not target.is_file() and not target.is_dir()
