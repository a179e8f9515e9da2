"""The store of an ensemble: a directory with a description, and one file for each block.

A block is written under a temporary name, synced and renamed, so that after a crash each file is
complete or absent.  A file has only arrays, in NumPy's own format; loading it runs no code.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core import DalembertError, files
from . import block

VERSION = 3
_FORMAT = {"format": "dalembert ensemble", "version": VERSION}
ABOUT = "ensemble.json"
_GIVEN = re.compile(r"given-([0-9a-f]{12})-(.+)\.npy")  # for the members of a mark
_BLOCK = re.compile(r"block-(\d{9})\.npz")


class StoreError(DalembertError):
    """The store of an ensemble cannot be read, or its content is wrong."""


def _path(directory: str, index: int) -> Path:
    return Path(directory) / f"block-{index:09d}.npz"


# ---- the description ---------------------------------------------------------------------------


def create(
    directory: str, about: dict[str, Any], given: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Create a store, unless it exists, and return its description.

    In ``about``, data for JSON, "mark" identifies the ensemble; ``given`` are the values for
    members.  A directory with other files, or with another ensemble, raises ValueError.
    """
    root = Path(directory)
    root.mkdir(parents=True, exist_ok=True)
    mark = about["mark"]
    if not (root / ABOUT).exists():
        for path in sorted(root.iterdir()):
            if not _GIVEN.fullmatch(path.name) and not files.is_draft(path):
                raise ValueError(
                    f"store = {directory!r}: expected a new or empty directory, or a store, "
                    f"but it contains {path.name!r}"
                )
        for name, x in given.items():
            _save(root / f"given-{mark[:12]}-{name}.npy", x)
        text = json.dumps({**_FORMAT, **about}, indent=1)
        with contextlib.suppress(FileExistsError):  # of a process that was first
            files.create(root / ABOUT, text.encode())
    found = read_about(directory)
    if found["mark"] != about["mark"]:
        here, found = ({**x, **x["options"]} for x in (json.loads(json.dumps(about)), found))
        compared = dict.fromkeys((*here, *found))
        for key in ("mark", "block", "seal", "options", *_FORMAT):
            compared.pop(key, None)
        differs = [key for key in compared if found.get(key) != here.get(key)]
        raise ValueError(
            f"store = {directory!r} belongs to another ensemble, which differs in "
            f"{', '.join(differs) or 'the arguments of the members'}"
        )
    return found


def read_about(directory: str) -> dict[str, Any]:
    """Return the description of a store; raise ValueError if it is none, or of another version."""
    path = Path(directory) / ABOUT
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        is_store = about["format"] == "dalembert ensemble"
        version = about["version"]
    except FileNotFoundError:
        raise ValueError(
            f"{directory!r} is not the store of an ensemble: it has no {ABOUT}"
        ) from None
    except (ValueError, KeyError, TypeError, UnicodeDecodeError):
        is_store, version = False, None
    if not is_store:
        raise ValueError(f"{str(path)!r} is not the description of an ensemble")
    if version != VERSION:
        raise ValueError(
            f"{str(path)!r} has version {version!r}: this version of dalembert reads version "
            f"{VERSION}"
        )
    mark, size = about.get("mark"), about.get("block")
    if not isinstance(size, int) or size < 1 or about.get("seal") != seal(str(mark), size):
        raise ValueError(f"{str(path)!r} was edited, or is damaged")
    return about  # type: ignore[no-any-return]


def seal(mark: str, size: int) -> str:
    """Return a digest of the size of the blocks and the mark of the ensemble."""
    return hashlib.sha256(f"{mark} {size}".encode()).hexdigest()


def tidy(directory: str) -> None:
    """Remove temporary files of killed processes that are at least an hour old."""
    for path in Path(directory).iterdir():
        if files.is_draft(path):
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > 3600:
                    path.unlink()


def is_that(directory: str, mark: str) -> bool:
    """Return whether the store is visible from here."""
    with contextlib.suppress(ValueError, OSError):
        return bool(read_about(directory)["mark"] == mark)
    return False


def read_members(directory: str, mark: str) -> dict[str, np.ndarray]:
    """Return the values for the members, memory-mapped."""
    found = {}
    for path in sorted(Path(directory).iterdir()):
        if (match := _GIVEN.fullmatch(path.name)) and match[1] == mark[:12]:
            with _reading(path):
                found[match[2]] = np.load(path, mmap_mode="r", allow_pickle=False)
    return found


# ---- blocks ------------------------------------------------------------------------------------


def write(directory: str, index: int, mark: str, made: block.Block) -> None:
    """Write a block, unless the store now belongs to another ensemble."""
    if read_about(directory)["mark"] != mark:
        raise StoreError(f"{directory} is no longer the store of this ensemble")
    messages = made["messages"]
    arrays = {name: x for name, x in made.items() if name != "messages"}
    arrays["failed"] = np.array(sorted(messages), np.int64)
    arrays["messages"] = np.array([messages[k] for k in sorted(messages)], np.str_)
    arrays["mark"] = np.array([mark, str(index)])
    _save(_path(directory, index), arrays)


def there(directory: str, mark: str, count: int) -> list[int]:
    """Return the numbers of the blocks in the store; raise StoreError for a block of another."""
    found = []
    for path in sorted(Path(directory).iterdir()):
        match = _BLOCK.fullmatch(path.name)
        if match and int(match[1]) < count:
            _check(path, mark, int(match[1]))
            found.append(int(match[1]))
    return found


def read(directory: str, index: int, mark: str, *names: str) -> block.Block:
    """Return a block, or its arrays of these names, as far as it has them.

    A file that is damaged, or belongs to another ensemble, raises StoreError.
    """
    path = _path(directory, index)
    found = _load(path, ("mark", "failed", *names) if names else None)
    _require(path, found.pop("mark", None), mark, index)
    failed = found.pop("failed")
    if "messages" in found:
        found["messages"] = dict(zip(failed.tolist(), found["messages"].tolist()))
    return found


def names(directory: str, index: int) -> list[str]:
    """Return the names of the arrays of a block."""
    with zipfile.ZipFile(_path(directory, index)) as file:
        found = [name.removesuffix(".npy") for name in file.namelist()]
    return [name for name in found if name not in ("mark", "failed", "messages")]


def _check(path: Path, mark: str, index: int) -> None:
    """Raise StoreError unless a file is a complete block, as far as its zip directory shows."""
    with _reading(path), np.load(path, allow_pickle=False) as file:
        found = file["mark"] if "mark" in file.files else None
    _require(path, found, mark, index)


def _require(path: Path, found: Any, mark: str, index: int) -> None:
    if found is None or list(map(str, np.ravel(found))) != [mark, str(index)]:
        raise StoreError(
            f"{path} is not a block of this ensemble: remove it, and it will be computed again"
        )


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Raise StoreError if a file is missing or has no arrays."""
    try:
        yield
    except FileNotFoundError:
        raise StoreError(f"{path} is missing from the store") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        why = "it contains no arrays" if isinstance(error, ValueError) else error
        raise StoreError(
            f"{path} is damaged ({why}): remove it, and it will be computed again"
        ) from None


def damaged(directory: str, index: int, why: str) -> StoreError:
    """Return the exception for a damaged block."""
    path = _path(directory, index)
    return StoreError(f"{path} is damaged ({why}): remove it, and it will be computed again")


def _save(path: Path, arrays: Any) -> None:
    """Write an array, or several by name, to the disk, completely or not at all."""
    buffer = io.BytesIO()
    if isinstance(arrays, dict):
        np.savez(buffer, **arrays)
    else:
        np.save(buffer, arrays)
    files.replace(path, buffer.getbuffer())


def _load(path: Path, names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
    with _reading(path), np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files if names is None or name in names}
