"""Step-size refinement: the order of a scheme, measured and compared with what it promises.

The numbers come from ``dal_order_study`` of the core; here they become arrays, tables and words.
"""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _lib, geometry
from ._lib import ffi, lib
from .integration import INITIAL, Scheme
from .integration import schemes as named_schemes
from .system import System

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Fit", "Studies", "Study", "convergence", "studies"]

Array = NDArray[np.float64]

# Numbers of steps over one unit of time, for low orders and for the candidates of high ones.
LOW_ORDER = (80, 120, 160, 240, 320, 480, 640)
CANDIDATES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64, 80)
FINE = (100, 150, 200, 300)

FITS = ("state", "multipliers", "reaction", "midpoint", "global_q", "global_v",
        "global_multipliers")

ABOVE_FLOOR = 100.0  # an error counts if it is more than so many times the floor,
AT_FLOOR = 10.0  # and up to so many times it is roundoff: these are the rules of the core
WIDTH = 100  # of the plain table, at most


@dataclass(frozen=True)
class Fit:
    """A fitted order: errors proportional to ``h**slope`` over the points that count.

    Attributes
    ----------
    slope : float
        NaN if fewer than three points count.
    points : int
        How many errors counted, those at least 100 times above the floor.
    exact : bool
        True if every error is at the level of roundoff, so that there is no slope to fit.
    """

    slope: float
    points: int
    exact: bool

    @classmethod
    def read(cls, fit: Any) -> Fit:
        """Return the fit of a ``dal_fit``."""
        return cls(float(fit.slope), int(fit.points), bool(fit.exact))

    def order(self, loss: int = 0) -> str:
        """Return ``slope - loss`` in words: a number, "exact", or "-" if it is not known."""
        if self.exact:
            return "exact"
        return _order(self.slope - loss)


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """What step-size refinement found for one scheme on one system.

    Arrays have shape ``(k,)``, one entry for each step size.  Errors are largest components of
    differences, in the user's units; an entry of a run that failed is NaN.

    Attributes
    ----------
    system, scheme : System, Scheme
    q0, v0 : ndarray, shape (n,)
        Initial data in D.
    t0, t_end : float
        Interval of time.
    initial : str or None
        How runs with kept nodes started.
    steps : ndarray of int
        Numbers of steps, in the order in which they were given.
    h : ndarray
        Step sizes ``(t_end - t0) / steps``.
    q_error, v_error, multiplier_error : ndarray
        At ``t_end``, against the reference; the multipliers by the formula lambda(q, v).
    local_error, local_multiplier_error : ndarray
        Of (q, v) and of lambda(q, v) after one step from exact data.
    local_reaction_error, local_midpoint_error : ndarray
        Of the scheme's own multiplier of that step, against lambda at its end and at its middle.
    residual, residual_eps : ndarray
        Worst relative residual of D and of D_eps over the run; the latter is NaN for a scheme
        with several sub-steps, which has no D_eps.
    energy_error : ndarray
        max |E - E0| / max(|E0|, 1) over the run.
    failed : ndarray of int
        Status of each run, 0 if it went through.
    fits : dict of str to Fit
        "state", "multipliers", "reaction", "midpoint" of the one-step errors, "global_q",
        "global_v", "global_multipliers", "global_state" of the errors at ``t_end``.
    p, s : float
        Measured order of (q, v) and of the scheme's own multipliers, slopes of the one-step
        errors minus 1.
    floor : float
        Errors below ``100 * floor`` do not count.
    reference : float
        Accuracy of the reference solution, 0 for an exact one.
    keeps_D, keeps_D_eps : bool
        Whether the residual stayed at roundoff at every stored state of every run.
    holds : bool or None
        The verdict; None if nothing is promised or too few points count.
    text : str
        The verdict in words.
    """

    system: System
    scheme: Scheme
    q0: Array
    v0: Array
    t0: float
    t_end: float
    initial: str | None
    steps: NDArray[np.int64]
    h: Array
    q_error: Array
    v_error: Array
    multiplier_error: Array
    local_error: Array
    local_multiplier_error: Array
    local_reaction_error: Array
    local_midpoint_error: Array
    residual: Array
    residual_eps: Array
    energy_error: Array
    failed: NDArray[np.int64]
    fits: dict[str, Fit]
    p: float
    s: float
    floor: float
    reference: float
    keeps_D: bool
    keeps_D_eps: bool
    holds: bool | None
    text: str

    @property
    def state_error(self) -> Array:
        """Error of (q, v) at ``t_end``, the larger of the two, shape (k,)."""
        return np.maximum(self.q_error, self.v_error)

    @property
    def q_orders(self) -> Array:
        """Local orders of ``q_error`` between neighbours, shape (k,).

        NaN for the first entry, and where an error is at the level of roundoff.
        """
        return _local_orders(self.h, self.q_error, self.floor)

    @property
    def v_orders(self) -> Array:
        """Local orders of ``v_error``, as `q_orders`."""
        return _local_orders(self.h, self.v_error, self.floor)

    @property
    def multiplier_orders(self) -> Array:
        """Local orders of ``multiplier_error``, as `q_orders`."""
        return _local_orders(self.h, self.multiplier_error, self.floor)

    @property
    def promise(self) -> str:
        """The promised (p, s) in words, "nothing" for a record without a promise."""
        if self.scheme.order == 0:
            return "nothing"
        return f"({self.scheme.order}, {self.scheme.multiplier_order})"

    @property
    def keeps(self) -> str:
        """Which set the runs kept to roundoff: "D", "D_eps", "D and D_eps" or "neither"."""
        kept = [name for name, is_kept in (("D", self.keeps_D), ("D_eps", self.keeps_D_eps))
                if is_kept]
        return " and ".join(kept) or "neither"

    @property
    def verdict(self) -> str:
        """One word: "holds", "fails", "no promise" or "too few points"."""
        if self.holds is None:
            return "no promise" if self.scheme.order == 0 else "too few points"
        return "holds" if self.holds else "fails"

    def columns(self) -> list[Column]:
        """The columns of the table: step size, errors with local orders, residuals, energy."""
        def group(title: str, values: Array, orders: Array | None = None) -> Column:
            cells = [_number(x) for x in values]
            if orders is not None:
                cells = [f"{c:>7} {_order(o):>5}" for c, o in zip(cells, orders)]
            return Column(title, cells)

        return [
            Column("h", [f"{h:.4g}" for h in self.h]),
            group("q error order", self.q_error, self.q_orders),
            group("v error order", self.v_error, self.v_orders),
            group("lambda order", self.multiplier_error, self.multiplier_orders),
            group("res. D", self.residual),
            group("D_eps", self.residual_eps),
            group("energy", self.energy_error),
        ]

    def heading(self) -> str:
        """One line that says what was studied."""
        start = f", initial={self.initial!r}" if self.initial else ""
        return (f"{self.scheme.name} on {self.system.name}, "
                f"t = {self.t0:g} to {self.t_end:g}{start}")

    def summary(self) -> str:
        """The verdict in words, then the points that the fits rest on; two lines."""
        at_end = ", ".join(f"{name} {self.fits[key].order()}" for name, key in
                           (("q", "global_q"), ("v", "global_v"),
                            ("lambda", "global_multipliers")))
        return (f"{self.text}\n"
                f"p over {_points(self.fits['state'])}, s over {_points(self.fits['reaction'])}; "
                f"orders at t_end: {at_end}; kept to roundoff: {self.keeps}.")

    def table(self, width: int = WIDTH) -> str:
        """Return the table and the verdict as plain text, ``width`` characters wide at most."""
        return "\n".join([self.heading(), *_plain(self.columns(), width),
                          *_wrapped(self.summary(), width)])

    def __str__(self) -> str:
        return self.table()

    def __repr__(self) -> str:
        return (f"<Study of {self.scheme.name} on {self.system.name}: p = {self.p:.2f}, "
                f"s = {self.s:.2f}, {self.verdict}>")

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        from rich.text import Text

        yield Text(self.heading(), style="bold")
        yield from _rich_tables(self.columns(), options.max_width)
        first, rest = self.summary().split("\n")
        yield Text(first, style=_colour(self.holds))
        yield Text(rest)

    def _repr_html_(self) -> str:
        from .report import study_html

        return study_html(self)

    def show(self, file: TextIO | None = None) -> None:
        """Print the table: with rich on a terminal if rich is installed, else plain.

        Parameters
        ----------
        file : text stream, optional
            Default: standard output.
        """
        _show(self, file)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the errors over the step size; see `dalembert.plot.convergence`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        """
        from .plot import convergence as draw

        return draw(self, ax)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, strings and lists, ready for JSON.

        What is not finite is None.
        """
        arrays = ("steps", "h", "q_error", "q_orders", "v_error", "v_orders", "multiplier_error",
                  "multiplier_orders", "local_error", "local_multiplier_error",
                  "local_reaction_error", "local_midpoint_error", "residual", "residual_eps",
                  "energy_error", "failed")
        return {
            "system": self.system.name,
            "parameters": {key: float(x) for key, x in self.system.parameters.items()},
            "q0": self.q0.tolist(),
            "v0": self.v0.tolist(),
            "t0": self.t0,
            "t_end": self.t_end,
            "scheme": self.scheme.name,
            "nodes": self.scheme.nodes,
            "initial": self.initial,
            "promised": {"p": self.scheme.order, "s": self.scheme.multiplier_order},
            **{name: [_plain_number(x) for x in getattr(self, name).tolist()] for name in arrays},
            "fits": {key: {"slope": _plain_number(fit.slope), "points": fit.points,
                           "exact": fit.exact} for key, fit in self.fits.items()},
            "p": _plain_number(self.p),
            "s": _plain_number(self.s),
            "floor": self.floor,
            "reference": self.reference,
            "keeps_D": self.keeps_D,
            "keeps_D_eps": self.keeps_D_eps,
            "holds": self.holds,
            "verdict": self.verdict,
            "text": self.text,
        }


class Studies(Sequence[Study]):
    """Studies of several schemes on one system; a sequence of `Study`."""

    def __init__(self, items: Iterable[Study]) -> None:
        self._items = tuple(items)

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: Any) -> Any:
        found = self._items[index]
        return Studies(found) if isinstance(index, slice) else found

    @property
    def holds(self) -> bool | None:
        """False if a verdict fails, True if none fails and one holds, else None."""
        verdicts = {study.holds for study in self}
        return False if False in verdicts else True if True in verdicts else None

    def columns(self) -> list[Column]:
        """The columns of the overview, one row for each scheme."""
        def column(title: str, text: Any) -> Column:
            return Column(title, [text(study) for study in self])

        return [
            Column("scheme", [study.scheme.name for study in self], left=True),
            column("promised", lambda x: x.promise),
            column("p", lambda x: x.fits["state"].order(1)),
            column("s", lambda x: x.fits["reaction"].order(1)),
            column("res. D", lambda x: _number(_worst(x.residual))),
            column("D_eps", lambda x: _number(_worst(x.residual_eps))),
            column("energy", lambda x: _number(_worst(x.energy_error))),
            column("keeps", lambda x: x.keeps),
            column("verdict", lambda x: x.verdict),
        ]

    def sentence(self) -> str:
        """The verdict of all in one sentence."""
        if not self._items:
            return "No scheme was studied."
        system = self[0].system.name
        failing = [study.scheme.name for study in self if study.holds is False]
        holding = [study for study in self if study.holds]
        undecided = [study.scheme.name for study in self if study.holds is None]
        rest = f"; no verdict on {_listing(undecided)}" if undecided else ""
        if failing:
            do = "does" if len(failing) == 1 else "do"
            return (f"On {system}, {_listing(failing)} {do} not deliver what is promised; "
                    f"{len(holding)} of {len(self)} schemes hold{rest}.")
        if not holding:
            return f"On {system} there is no verdict on {_listing(undecided)}."
        worst = max(_worst(x.residual if x.keeps_D else x.residual_eps) for x in holding)
        if len(holding) == 1:
            return (f"On {system}, {holding[0].scheme.name} has its promised order and keeps its "
                    f"constraint set to {worst:.1e}{rest}.")
        who = "both" if len(holding) == 2 else f"all {len(holding)}"
        return (f"On {system}, {who} schemes have their promised order and keep their constraint "
                f"set to {worst:.1e}{rest}.")

    def table(self, width: int = WIDTH) -> str:
        """Return all tables, the overview and the verdict as plain text, ``width`` wide at most."""
        tables = [study.table(width) + "\n" for study in self]
        overview = _plain(self.columns(), width) if self else []
        return "\n".join([*tables, *overview, *_wrapped(self.sentence(), width)])

    def __str__(self) -> str:
        return self.table()

    def __repr__(self) -> str:
        return f"<Studies of {', '.join(study.scheme.name for study in self)}>"

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        from rich.text import Text

        for study in self:
            yield study
            yield Text()
        yield from _rich_tables(self.columns(), options.max_width)
        yield Text(self.sentence(), style="bold " + _colour(self.holds))

    def _repr_html_(self) -> str:
        from .report import studies_html

        return studies_html(self)

    def show(self, file: TextIO | None = None) -> None:
        """Print all tables, then the overview; as `Study.show` does."""
        _show(self, file)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the errors over the step size; see `dalembert.plot.convergence`."""
        from .plot import convergence as draw

        return draw(self, ax)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, strings and lists, ready for JSON."""
        return {"version": _lib.version(), "holds": self.holds, "text": self.sentence(),
                "studies": [study.to_dict() for study in self]}


def convergence(
    system: System,
    scheme: Scheme | str | float,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float = 1.0,
    t0: float = 0.0,
    steps: Sequence[int] | None = None,
    initial: str | None = None,
    tolerance: float = 1e-14,
) -> Study:
    """Measure the order of a scheme by refining the step size.

    Parameters
    ----------
    system : System
    scheme : Scheme, str or float
        A record, the name of one, or beta.
    q0, v0 : array_like, shape (n,), optional
        Initial data in D, in the user's units.  Default: those of the system.
    t_end, t0 : float, optional
        Interval of time, in the user's units.
    steps : sequence of int, optional
        Numbers of steps over the interval.  The default depends on the promised order: small
        steps, for high orders as small as the round-off floor allows.
    initial : {"D", "D_eps", "project", "shift"}, optional
        How runs with kept nodes start; they refuse to start without.
    tolerance : float, optional
        Of the reference flow where the system has no exact solution.  Default: 1e-14.

    Returns
    -------
    Study

    Raises
    ------
    ValueError
        If an argument is out of range; the text names it.
    dalembert.DalembertError
        If the reference flow fails.  A run that fails is a failed entry of the study instead.

    Examples
    --------
    >>> import dalembert as dal
    >>> study = dal.convergence(dal.systems.particle(), "midpoint", t_end=1)
    >>> study.holds, round(study.fits["global_q"].slope)
    (True, 2)
    """
    record = Scheme.of(scheme)
    if record.is_reference:
        raise ValueError("scheme = 'reference': expected one with a step size to refine")
    t0, t_end = _lib.number(t0, "t0"), _lib.number(t_end, "t_end")
    x0 = np.concatenate(geometry.initial(system, q0, v0))
    if steps is None:
        def probe(duration: float, candidates: Sequence[int]) -> Study:
            return convergence(system, record, q0, v0, t0=t0, steps=candidates, initial=initial,
                               t_end=t0 + math.copysign(duration, t_end - t0),
                               tolerance=tolerance)

        steps = _default_steps(record.order, abs(t_end - t0), probe)
    counts = _counts(steps)
    numbers = ffi.new("size_t[]", counts)
    start = lib.DAL_INITIAL_NONE
    if initial is not None:
        start = _lib.choice(initial, "initial", INITIAL)
    definition = ffi.new("dal_order_def *", {
        "t0": t0,
        "t_end": t_end,
        "x0": _lib.pointer(x0),
        "steps": numbers,
        "count": len(counts),
        "initial": start,
        "tolerance": _lib.number(tolerance, "tolerance"),
    })
    points = ffi.new("dal_order_point[]", len(counts))
    order, error = ffi.new("dal_order *"), ffi.new("dal_error *")
    status = _lib.attempt(lib.dal_order_study, system._handle, record._record, definition, points,
                          order, error)
    if status < 0:
        raise _lib.failure(status, _lib.string(error.text))

    def column(member: str) -> Any:
        return np.array([getattr(point, member) for point in points])

    h, q_error, v_error = column("h"), column("q"), column("v")
    state = ffi.new("dal_fit *")
    worse = np.maximum(q_error, v_error)
    lib.dal_fit_order(len(h), _lib.pointer(h), _lib.pointer(worse), order.floor, state)
    fits = {name: Fit.read(getattr(order, name)) for name in FITS}

    return Study(
        system=system, scheme=record, q0=x0[:system.n], v0=x0[system.n:], t0=t0, t_end=t_end,
        initial=initial, steps=np.array(counts), h=h, q_error=q_error, v_error=v_error,
        multiplier_error=column("multipliers"),
        local_error=column("local_state"), local_multiplier_error=column("local_multipliers"),
        local_reaction_error=column("local_reaction"),
        local_midpoint_error=column("local_midpoint"), residual=column("residual"),
        residual_eps=column("residual_eps"), energy_error=column("energy"),
        failed=column("failed"), fits={**fits, "global_state": Fit.read(state)}, p=order.p,
        s=order.s, floor=order.floor, reference=order.reference, keeps_D=bool(order.keeps_D),
        keeps_D_eps=bool(order.keeps_D_eps), holds={1: True, 0: False}.get(order.holds),
        text=_lib.string(order.text))


def studies(
    system: System,
    schemes: Iterable[Scheme | str | float] | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float = 1.0,
    t0: float = 0.0,
    steps: Sequence[int] | None = None,
    initial: str | None = None,
    tolerance: float = 1e-14,
    progress: bool = False,
) -> Studies:
    """Measure the order of several schemes on one system.

    Parameters
    ----------
    system : System
    schemes : iterable of Scheme, str or float, optional
        Default: every named scheme.
    initial : {"D", "D_eps", "project", "shift"}, optional
        How runs with kept nodes start.  Default: "D_eps"; schemes with moved nodes need none.
    progress : bool, optional
        Show a progress bar on a terminal if tqdm is installed.
    q0, v0, t_end, t0, steps, tolerance
        As in `convergence`.

    Returns
    -------
    Studies
        In the order of ``schemes``.

    Raises
    ------
    ValueError, dalembert.DalembertError
        As `convergence`.

    Examples
    --------
    >>> import dalembert as dal
    >>> found = dal.studies(dal.systems.particle(), ["midpoint", "leapfrog"])
    >>> found.holds
    True
    """
    records = [Scheme.of(x) for x in (named_schemes() if schemes is None else schemes)]
    return Studies(
        convergence(system, record, q0, v0, t_end=t_end, t0=t0, steps=steps,
                    initial=(initial or "D_eps") if record.nodes == "kept" else None,
                    tolerance=tolerance)
        for record in _progress(records, progress))


def _default_steps(order: int, duration: float, probe: Callable[..., Study]) -> list[int]:
    """Choose numbers of steps whose errors tell the order.

    One-step errors h^(p+1) have to stand clear of the floor, with h as small as that allows: they
    are a power of h only in the limit.  Up to order 2 any small h will do.  For a higher order
    ``probe`` studies some steps over about a unit of time, and the finest over a factor of two
    are taken.  The multipliers, whose order is low whatever p is, need smaller h: FINE.
    """
    units = max(1, round(duration))
    if order <= 2:
        return [count * units for count in LOW_ORDER]
    tried = probe(duration / units, CANDIDATES)
    floor = tried.floor if units == 1 else probe(duration, (1,)).floor
    clear = [int(count) for count, error in zip(tried.steps, tried.local_error)
             if error > ABOVE_FLOOR * floor]
    finest = [count for count in clear if 2 * count >= clear[-1]]
    chosen = clear[-max(len(finest), 3):] or CANDIDATES[:3]
    if chosen[-1] < 2 * chosen[0]:
        chosen = clear[-len(chosen) - 1:]
    return [count * units for count in (*chosen, *FINE)]


def _counts(steps: Iterable[int]) -> list[int]:
    counts = []
    for i, count in enumerate(steps):
        if not isinstance(count, (int, np.integer)) or count < 1:
            raise ValueError(f"steps[{i}] = {count!r}: expected a whole number of at least 1")
        counts.append(int(count))
    if not counts:
        raise ValueError("steps is empty: expected numbers of steps")
    return counts


@dataclass(frozen=True)
class Column:
    """A column of a table as text; ``left``: flush left."""

    title: str
    cells: list[str]
    left: bool = False

    @property
    def width(self) -> int:
        return max(len(text) for text in (self.title, *self.cells))


def _blocks(columns: list[Column], width: int) -> list[list[Column]]:
    """Split the columns into tables of at most ``width`` characters that repeat the first one."""
    first, *rest = columns
    blocks, room = [[first]], width - first.width
    for column in rest:
        if column.width + 2 > room and len(blocks[-1]) > 1:
            blocks.append([first])
            room = width - first.width
        blocks[-1].append(column)
        room -= column.width + 2
    return blocks


def _plain(columns: list[Column], width: int) -> list[str]:
    lines = []
    for block in _blocks(columns, width):
        for row in zip(*([c.title, *c.cells] for c in block)):
            lines.append("  ".join(text.ljust(c.width) if c.left else text.rjust(c.width)
                                   for text, c in zip(row, block)).rstrip())
    return lines


def _wrapped(text: str, width: int) -> list[str]:
    return [line for part in text.split("\n") for line in textwrap.wrap(part, width)]


def _points(fit: Fit) -> str:
    return "1 point" if fit.points == 1 else f"{fit.points} points"


def _rich_tables(columns: list[Column], width: int) -> Iterator[Any]:
    from rich.table import Table

    for block in _blocks(columns, width):
        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
        for column in block:
            table.add_column(column.title, justify="left" if column.left else "right",
                             no_wrap=True)
        for row in zip(*(column.cells for column in block)):
            table.add_row(*row)
        yield table


def _show(item: Study | Studies, file: TextIO | None) -> None:
    out = sys.stdout if file is None else file
    if not out.isatty():
        print(item, file=out)
        return
    try:
        from rich.console import Console
    except ImportError:
        print(item.table(min(WIDTH, shutil.get_terminal_size().columns)), file=out)
    else:
        Console(file=out, highlight=False).print(item)


def _progress(records: list[Scheme], wanted: bool) -> Iterable[Scheme]:
    if wanted and sys.stderr.isatty():
        try:
            from tqdm import tqdm
        except ImportError:
            return records
        return tqdm(records, unit="scheme", leave=False)
    return records


def _colour(holds: bool | None) -> str:
    return {True: "green", False: "red", None: "yellow"}[holds]


def _local_orders(h: Array, error: Array, floor: float) -> Array:
    orders = np.full(len(h), np.nan)
    clear = np.where(error > AT_FLOOR * floor, error, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        orders[1:] = np.diff(np.log(clear)) / np.diff(np.log(np.abs(h)))
    return np.where(np.isfinite(orders), orders, np.nan)


def _number(x: float) -> str:
    return "-" if not math.isfinite(x) else "0" if x == 0 else f"{x:.1e}"


def _order(x: float) -> str:
    return "-" if not math.isfinite(x) else f"{round(x, 2) + 0.0:.2f}"  # no -0.00


def _worst(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else math.nan


def _plain_number(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _listing(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
