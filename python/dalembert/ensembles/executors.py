"""Execution of the blocks of an ensemble, by threads of this process or by an executor."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import functools
import os
import pickle
import threading
from collections.abc import Callable
from typing import Any

from ..core import arguments, lib
from . import block, store
from .spec import EnsembleSpec, Common
from .result import Memory, Stored

PIECE_SECONDS = 0.1  # after which the progress is shown
_ATTEMPTS = 3  # of a block that more than one worker has died with, before it is tried alone

Take = Callable[[int, block.Block | None], None]


def threads_of(threads: int | None) -> int:
    """Return the number of threads, by default one for each processor that this process may use."""
    if threads is not None:
        return arguments.integer(threads, "threads", 1, 10_000)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Blocks:
    """The members of an ensemble in blocks of one size; the last block may have fewer."""

    def __init__(self, spec: EnsembleSpec, size: int) -> None:
        self.spec, self.size = spec, size

    def __len__(self) -> int:
        return -(-self.spec.count // self.size)

    def range(self, index: int) -> tuple[int, int]:
        """Return the first member of a block, and the first after it."""
        return index * self.size, min((index + 1) * self.size, self.spec.count)


# ---- here --------------------------------------------------------------------------------------


def by_threads(
    blocks: Blocks,
    left: list[int],
    data: Memory | Stored,
    tell: Callable[[float], None],
    threads: int,
) -> None:
    """Compute the blocks ``left`` in threads of this process.

    ``tell(done)`` is called several times a second with the number of members done.
    """
    stop, under_way = threading.Event(), dict.fromkeys(left, 0.0)

    def job(index: int) -> block.Block:
        begin, end = blocks.range(index)
        spec = blocks.spec

        def show(done: float) -> None:
            under_way[index] = done

        made = block.make(spec.common, spec.block(begin, end), end - begin, stop, show)
        under_way[index] = end - begin
        return made

    with futures.ThreadPoolExecutor(threads) as executor:
        _run(
            executor, left, 2 * threads, lambda index: executor.submit(job, index), data.put,
            lambda: tell(sum(under_way.values())), stop,
        )  # fmt: skip


def _run(
    executor: futures.Executor,
    todo: list[int],
    window: int,
    submit: Callable[[int], futures.Future[Any]],
    take: Take,
    tell: Callable[[], None],
    stop: threading.Event | None = None,
    lost: Callable[[int], block.Block] | None = None,
) -> None:
    """Submit blocks, at most ``window`` at a time, and take their results as they finish.

    ``lost(index)`` replaces a block that an executor has given up because its workers died.
    """
    todo, pending = list(reversed(todo)), dict[futures.Future[Any], int]()

    def finish(future: futures.Future[Any]) -> None:
        try:
            made = future.result()
        except Exception as error:
            if lost is None or type(error).__name__ != "KilledWorker":  # of dask, after 4 workers
                raise
            made = lost(pending[future])
        take(pending[future], made)
        del pending[future]

    try:
        while todo or pending:
            while todo and len(pending) < window:
                pending[submit(todo[-1])] = todo[-1]
                todo.pop()
            done, _ = futures.wait(pending, PIECE_SECONDS, futures.FIRST_COMPLETED)
            for future in done:
                finish(future)
            tell()
    except BaseException:
        if stop is not None:
            stop.set()
        for future in pending:
            future.cancel()
        for future in [*pending]:  # what was made is not lost
            if stop is not None or (future.done() and not future.cancelled()):
                with contextlib.suppress(BaseException):
                    finish(future)
        raise


# ---- elsewhere ---------------------------------------------------------------------------------


@functools.lru_cache(maxsize=4)
def _common(pickled: bytes) -> Common:
    """Return the unpickled properties; each process creates its system once."""
    common: Common = pickle.loads(pickled)
    return common


@functools.lru_cache(maxsize=4)
def _stored_spec(pickled: bytes, path: str, mark: str, shape: tuple[int, ...]) -> EnsembleSpec:
    """Return the definition in a store visible from here; its arrays are memory-mapped."""
    return EnsembleSpec.of_arrays(
        store.read_members(path, mark), common=_common(pickled), shape=shape, axes=(), ticks={}
    )


class Unseen(Exception):
    """The store is not visible from the worker."""


def remote(
    pickled: bytes,
    index: int,
    begin: int,
    end: int,
    place: tuple[str, str, tuple[int, ...]] | None,
    rows: Any,
) -> block.Block | None:
    """Compute a block in another process.

    ``place`` is the path of the store, the mark of the ensemble and its shape.  If the store is
    visible, the values for members are read from it, the block is written to it, and the result is
    None.  Otherwise ``rows`` are required.
    """
    seen = place is not None and store.is_that(*place[:2])
    if rows is None and not seen:
        raise Unseen
    if rows is None:
        rows = _stored_spec(pickled, *place).block(begin, end)  # type: ignore[misc]
    made = block.make(_common(pickled), rows, end - begin, threading.Event(), lambda far: None)
    if not seen:
        return made
    store.write(place[0], index, place[1], made)  # type: ignore[index]
    return None


def by_executor(
    given: Any,
    blocks: Blocks,
    left: list[int],
    data: Memory | Stored,
    tell: Callable[[float], None],
) -> None:
    """Compute blocks by an executor, or by one that a function returns.

    Arguments are as for `by_threads`.

    If the processes of a pool die, their blocks are submitted again, to a new pool of the same
    kind.  A block during which three pools died is tried alone.  If that pool dies too, its members
    have failed.
    """
    spec, tried, remaining = blocks.spec, dict.fromkeys(left, 0), dict.fromkeys(left)
    pickled = pickle.dumps(spec.common)
    place = (data.path, data.mark, spec.shape) if isinstance(data, Stored) else None
    sends = place is None
    under_way: set[int] = set()

    def took(index: int, made: block.Block | None) -> None:
        if made is not None:
            data.put(index, made)
        elif isinstance(data, Stored):
            data.know(index)
        del remaining[index]
        under_way.discard(index)

    with _Pools(given) as pools:
        while remaining:
            executor = pools.current

            def submit(index: int) -> futures.Future[Any]:
                begin, end = blocks.range(index)
                under_way.add(index)
                rows = spec.block(begin, end) if sends else None
                return executor.submit(remote, pickled, index, begin, end, place, rows)

            now = [index for index in remaining if tried[index] < _ATTEMPTS]
            alone = not now
            try:
                _run(
                    executor, now or [next(iter(remaining))], 1 if alone else pools.window, submit,
                    took, lambda: tell((len(left) - len(remaining)) * blocks.size),
                    lost=lambda index: _lost(spec, blocks, index),
                )  # fmt: skip
            except Unseen:
                sends = True
                under_way.clear()
            except futures.BrokenExecutor:
                if not pools.renew():
                    raise
                for index in [*under_way]:
                    tried[index] += 1
                    if alone:
                        took(index, _lost(spec, blocks, index))
                under_way.clear()


def _lost(spec: EnsembleSpec, blocks: Blocks, index: int) -> block.Block:
    """Return a block whose workers died: all of its members have failed."""
    begin, end = blocks.range(index)
    made = block.empty(spec.common, spec.rows, end - begin)
    made["status"][:] = lib.DAL_EUSER
    made["messages"] = dict.fromkeys(
        range(end - begin), "the worker process of this block of members died repeatedly"
    )
    return made


class _Pools:
    """An executor, replaced by one of the same kind if it breaks."""

    def __init__(self, given: Any) -> None:
        self._own = not isinstance(given, futures.Executor)
        self._make = given if self._own else _like(given)
        self.current = given() if callable(given) else given
        if not isinstance(self.current, futures.Executor):
            raise ValueError(
                f"executor = {arguments.shown(given)}: expected a concurrent.futures.Executor, or "
                "a function that returns one"
            )

    @property
    def window(self) -> int:
        """Number of blocks to submit at a time: enough for all workers, limited for memory."""
        workers = getattr(self.current, "_max_workers", None)
        if (client := getattr(self.current, "_client", None)) is not None:  # of dask
            workers = sum(client.nthreads().values())
        return max(64, 4 * int(workers or 16))

    def renew(self) -> bool:
        """Replace the executor; return False if that is not possible."""
        if self._make is None:
            return False
        if self._own:
            self.current.shutdown(wait=False, cancel_futures=True)
        self.current, self._own = self._make(), True
        return True

    def __enter__(self) -> _Pools:
        return self

    def __exit__(self, *of: Any) -> None:
        if not self._own:
            return
        if of[0] is not None:  # what its processes are at is not wanted any more
            for process in [*(getattr(self.current, "_processes", None) or {}).values()]:
                process.terminate()
        self.current.shutdown(wait=of[0] is None, cancel_futures=True)


def _like(executor: Any) -> Callable[[], futures.Executor] | None:
    """Return a function that creates a pool of processes like this; None for other executors."""
    if not isinstance(executor, futures.ProcessPoolExecutor):
        return None
    names = {"max_workers": "_max_workers", "mp_context": "_mp_context",
             "initializer": "_initializer", "initargs": "_initargs"}  # fmt: skip
    given = {name: getattr(executor, x) for name, x in names.items() if hasattr(executor, x)}
    return functools.partial(futures.ProcessPoolExecutor, **given)
