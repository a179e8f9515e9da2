"""Poincare sections: return maps with their derivatives, and periodic orbits."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..core import (
    ROUNDOFF,
    Array,
    ConvergenceError,
    DalembertError,
    arguments,
    require_system,
)
from ..run import Event, Scheme, integrate, variations
from ..run.laws import is_expression
from ..symbolic import event, printing, symbols
from ..system import System
from ..system.twins import twin

_ITERATIONS, _HALVINGS, _TO_SECTION = 50, 8, 4
_CLOSE = 1e-12  # of an orbit, relative to the size of the state
_NEARBY = 1e-8  # so near a section, relative to the size of the state, a start is in it
_JUMPS = "sign", "Heaviside", "Piecewise"
_AT_REST = 1e-9  # a rate, relative to the size of the state
_RANK = 1e-9  # singular values below belong to families of orbits


@dataclass(frozen=True, eq=False)
class Return:
    """A return to a section, and the derivative of the return map.

    Attributes
    ----------
    t : float
        The time of the return.
    q, v : ndarray, shape (n,)
        The state there.
    start : ndarray, shape (2n, K)
        A basis of the tangent space of D at the start.
    derivative : ndarray, shape (2n, K)
        The derivatives of (q, v) in these directions.  They are tangent to D and to the section.
    """

    t: float
    q: Array
    v: Array
    start: Array
    derivative: Array

    @property
    def x(self) -> Array:
        return np.concatenate([self.q, self.v])


@dataclass(frozen=True, eq=False)
class Orbit:
    """A periodic orbit.

    Attributes
    ----------
    period : float
    q, v : ndarray, shape (n,)
        Its state in the section.
    multipliers : ndarray, complex
        The eigenvalues of the derivative of the return map, the largest first.  The orbit is
        unstable if one is outside of the unit circle.  A first integral, and a family of orbits,
        have the multiplier 1.
    residual : float
        How far the state is from its return.
    iterations : int
    """

    period: float
    q: Array
    v: Array
    multipliers: Array
    residual: float
    iterations: int


class Section:
    """A Poincare section, see `section`."""

    def __init__(
        self, system: System, g: Any, direction: float, returning: list[int],
        periods: Array, longest: float, scheme: Scheme,
    ) -> None:  # fmt: skip
        self.system, self.g, self.direction = system, g, direction
        self._returning, self._periods = returning, periods
        self._longest, self._scheme = longest, scheme

    def points(
        self, q0: ArrayLike | None = None, v0: ArrayLike | None = None, *, count: int = 100,
        t0: float = 0.0,
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """Return the times and states of so many crossings: t (N,), q (N, n) and v (N, n).

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y, z = dal.coordinates("x y z")
        >>> section = dal.section(dal.systems.contact_oscillator(), x)
        >>> t, q, v = section.points(count=5)
        >>> q.shape, bool(abs(q[:, 0]).max() < 1e-14)
        ((5, 3), True)
        """
        x0 = geometry.initial_state(self.system, q0, v0)
        count = arguments.integer(count, "count", 1)
        times, states = self._crossings(x0, float(t0), count)
        n = self.system.n
        return times, states[:, :n], states[:, n:]

    def map(
        self, q: ArrayLike | None = None, v: ArrayLike | None = None, *, returns: int = 1,
        t: float = 0.0,
    ) -> Return:  # fmt: skip
        """Return the state and the derivative at a later crossing, by default the next one.

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y, z = dal.coordinates("x y z")
        >>> section = dal.section(dal.systems.contact_oscillator(), x)
        >>> section.map([0, 1, 0], [1, 0, -1]).derivative.shape
        (6, 5)
        """
        x0 = geometry.initial_state(self.system, q, v, "q", "v")
        return self._map(x0, float(t), arguments.integer(returns, "returns", 1))

    def orbit(
        self, q: ArrayLike | None = None, v: ArrayLike | None = None, *, returns: int = 1,
        energy: float | None = None, period: float | None = None, t: float = 0.0,
    ) -> Orbit:  # fmt: skip
        """Return the periodic orbit near a state, by Newton's method for the return map.

        If orbits form families, the nearest one is found.

        Parameters
        ----------
        q, v : array_like, shape (n,), optional
            A state in D near the orbit, and near the section.
        returns : int, optional
            The orbit closes at this return.
        energy : float, optional
            The energy of the orbit.
        period : float, optional
            The period of the equations, if they depend on time; that of the orbit has to be a
            multiple.
        t : float, optional

        Raises
        ------
        ConvergenceError
            If the iteration does not converge, or leads to an equilibrium.  Begin nearer to an
            orbit.
        ValueError
            If the numbers that return do not determine the state in the section, or the equations
            depend on time and have no period.
        """
        x = geometry.initial_state(self.system, q, v, "q", "v")
        returns, n = arguments.integer(returns, "returns", 1), self.system.n
        if self._depends_on_time and period is None:
            raise ValueError("the equations depend on time: give their period")
        g, _, rate = self._at(x, float(t))
        is_wrong = rate * self.direction < 0 or rate == 0
        if is_wrong or abs(g) > _NEARBY * (1.0 + np.linalg.norm(x)):
            times, states = self._crossings(x, float(t), 1)
            t, x = float(times[0]), states[0]
        newton = _Newton(self, returns, energy, float(t))
        here = newton.at(x)
        self._require_determined(here, float(t))
        for k in range(_ITERATIONS):
            size = 1.0 + np.linalg.norm(here.x[self._returning])
            better = None if here.residual <= ROUNDOFF * size else newton.improved(here)
            if better is None and here.residual <= _CLOSE * size:
                self._require_motion(here.x, float(t))
                self._require_period(here.end.t - t, period)
                multipliers = self._multipliers(here, float(t))
                return Orbit(
                    here.end.t - t, here.x[:n], here.x[n:], multipliers, here.residual, k
                )
            if better is None:
                break
            here = better
        raise ConvergenceError(
            f"no periodic orbit after {k} iterations: the state is {here.residual:.2g} from its "
            "return; begin nearer to an orbit, or name the numbers that return"
        )

    def _require_motion(self, x: Array, t: float) -> None:
        """Raise ConvergenceError if the numbers that return do not change."""
        rates = self.system.field(*np.split(x, 2), t)[self._returning]
        size = 1.0 + np.linalg.norm(x[self._returning])
        if np.linalg.norm(rates) <= _AT_REST * size:
            raise ConvergenceError(
                "the iteration leads to an equilibrium, where the numbers that return do not "
                "change; begin farther from it"
            )

    @functools.cached_property
    def _depends_on_time(self) -> bool:
        found = twin(self.system, "series")
        model = self.system._model if found is None else found._model
        if model is None:
            return False
        every = (model.L, *model.constraints, *(model.force or ()), self.g)
        return any(s.name == "t" for e in every for s in e.free_symbols)

    def _require_determined(self, here: _Iterate, t: float) -> None:
        """Raise ValueError if different states in the section have the same numbers."""
        start = here.end.start @ self._within(here, t)
        rank = np.linalg.matrix_rank(start[self._returning] / np.linalg.norm(start, axis=0))
        if rank < start.shape[1]:
            raise ValueError(
                f"returning: {len(self._returning)} numbers do not determine the state in the "
                f"section, which has {start.shape[1]} dimensions without the coordinates that need "
                "not return; name more of them"
            )

    def _require_period(self, found: float, period: float | None) -> None:
        """Raise ConvergenceError unless a period is a multiple of that of the equations."""
        if period is not None and abs(found / period - round(found / period)) > 1e-9:
            raise ConvergenceError(
                f"the return takes {found:.12g}, which is no multiple of the period {period:g} of "
                "the equations; choose a section that depends on time"
            )

    # ---- one return --------------------------------------------------------------------------

    @functools.cached_property
    def _slopes(self) -> Any:
        """A function of (t, q, v, p): g, its derivatives by q and v, and by t."""
        import sympy

        time = symbols.TIME
        model = event.model(self.system, [("g", self.g)])
        (g,) = model.invariants
        of = {"t": time, "q": model.q, "v": model.v, "p": model.p}
        slopes = (sympy.diff(g, s) for s in (*model.q, *model.v, time))
        return printing.function(of, [g, *slopes])

    def _slopes_at(self, x: Array, t: float) -> tuple[float, Array, float]:
        """Return g, its gradient, and its derivative by t."""
        q, v = np.split(x, 2)
        values = np.array(self._slopes(t, q, v, [*self.system.parameters.values()]), dtype=float)
        return float(values[0]), values[1:-1], float(values[-1])

    def _at(self, x: Array, t: float) -> tuple[float, Array, float]:
        """Return g, its gradient, and its rate along the motion."""
        g, gradient, by_time = self._slopes_at(x, t)
        return g, gradient, float(gradient @ self.system.field(*np.split(x, 2), t)) + by_time

    def _crossings(self, x0: Array, t0: float, count: int) -> tuple[Array, Array]:
        """Return times and states of so many crossings after the start."""
        g, gradient, rate = self._at(x0, t0)
        near = 0.0
        if abs(g) <= _NEARBY * np.linalg.norm(gradient) * (1.0 + np.linalg.norm(x0)) and rate:
            near = 2.0 * abs(g / rate) + 1e-13 * (1.0 + abs(t0))  # the start is a crossing
        for extra in (0, 1):
            times, states = self._run(x0, t0, count + extra)
            late = times - t0 > near
            if late.sum() >= count:
                return times[late][:count], states[late][:count]
        raise ValueError(
            f"the motion has {late.sum()} crossings up to t = {t0 + count * self._longest:g}, not "
            f"{count}; give a larger t_max"
        )

    def _run(self, x0: Array, t0: float, count: int) -> tuple[Array, Array]:
        one = Event(self.g, direction=self.direction, terminal=count)
        q, v = np.split(x0, 2)
        run = integrate(
            self.system, self._scheme, q, v, t0=t0, t_end=t0 + count * self._longest,
            events=[one],
            stride=10**9,
        )  # fmt: skip
        return run.t_events[0], run.x_events[0]

    def _map(self, x0: Array, t0: float, returns: int) -> Return:
        n = self.system.n
        times, states = self._crossings(x0, t0, returns)
        t, x = float(times[-1]), states[-1]
        q, v = np.split(x0, 2)
        found = variations(
            self.system, q, v, t0=t0, t_eval=[t0, t], tolerance=self._scheme.tolerance
        )
        start, end = found.dx
        moves = found.rate[-1]  # before a jump, if the section is on one
        _, gradient, by_time = self._slopes_at(x, t)
        rate = gradient @ moves + by_time
        if rate == 0.0:
            raise ValueError(f"the motion touches the section at t = {t:g}")
        end = end - np.outer(moves, gradient @ end / rate)
        return Return(t, x[:n], x[n:], start, end)

    # ---- orbits ------------------------------------------------------------------------------

    def _off(self, end: Array, start: Array) -> Array:
        """Return how far a state is from its return, in the numbers that return."""
        off = (end - start)[self._returning]
        turns = np.isfinite(self._periods)
        off[turns] = np.remainder(
            off[turns] + self._periods[turns] / 2, self._periods[turns]
        ) - self._periods[turns] / 2
        return off

    def _free(self, here: Return) -> Array:
        """Return the directions of the start in which the coordinates that need not return stay."""
        fixed = [i for i in range(self.system.n) if i not in self._returning]
        return _kernel(here.start[fixed])

    def _energy_slope(self, x: Array, t: float) -> Array:
        """Return the derivatives of the energy, by differences of order 4."""
        n, h = self.system.n, 1e-3

        def energy(y: Array) -> float:
            return float(self.system.energy(y[:n], y[n:], t))

        found = np.empty_like(x)
        for i, e in enumerate(np.eye(2 * n)):
            one, two = (energy(x + k * h * e) - energy(x - k * h * e) for k in (1, 2))
            found[i] = (8 * one - two) / (12 * h)
        return found

    def _within(self, here: _Iterate, t: float) -> Array:
        """Return the free directions that are tangent to the section."""
        free = self._free(here.end)
        gradient = self._at(here.x, t)[1]
        return free @ _kernel((gradient @ here.end.start @ free)[None])

    def _multipliers(self, here: _Iterate, t: float) -> Array:
        """Return the eigenvalues of the derivative within the section."""
        within = self._within(here, t)
        start = (here.end.start @ within)[self._returning]
        end = (here.end.derivative @ within)[self._returning]
        found = np.linalg.eigvals(np.linalg.lstsq(start, end, rcond=None)[0])
        return found[np.argsort(-abs(found))]


@dataclass(frozen=True, eq=False)
class _Iterate:
    """A state, its return, and the equations that an orbit satisfies."""

    x: Array
    end: Return
    values: Array

    @property
    def residual(self) -> float:
        return float(np.linalg.norm(self.values))


class _Newton:
    """Newton's iteration for a state that returns, in the section, with an energy if one is given.

    Steps have the least length, so where orbits form families the nearest one is found.
    """

    def __init__(self, section: Section, returns: int, energy: float | None, t: float) -> None:
        self.section, self.returns, self.energy, self.t = section, returns, energy, t

    def at(self, x: Array) -> _Iterate:
        """Return the iterate of a state."""
        section, n = self.section, self.section.system.n
        end = section._map(x, self.t, self.returns)
        values = [section._off(end.x, x), [section._at(x, self.t)[0]]]
        if self.energy is not None:
            values.append([float(section.system.energy(x[:n], x[n:], self.t)) - self.energy])
        return _Iterate(x, end, np.concatenate(values))

    def in_section(self, x: Array) -> Array:
        """Return a state of D in the section, near one that is near both."""
        section, n = self.section, self.section.system.n
        for _ in range(_TO_SECTION):
            q, v = x[:n], x[n:]
            x = np.concatenate([q, section.system.project(q, v, t=self.t)])
            g, _, rate = section._at(x, self.t)
            if rate == 0.0:
                raise ValueError("the motion touches the section")
            x = x - g / rate * section.system.field(x[:n], x[n:], self.t)
        return np.concatenate([x[:n], section.system.project(x[:n], x[n:], t=self.t)])

    def improved(self, here: _Iterate) -> _Iterate | None:
        """Return the next iterate, None if no step is shorter than it has to be."""
        section = self.section
        free = section._free(here.end)
        start, end = here.end.start @ free, here.end.derivative @ free
        gradient = section._at(here.x, self.t)[1]
        rows = [(end - start)[section._returning], (gradient @ start)[None]]
        if self.energy is not None:
            rows.append((section._energy_slope(here.x, self.t) @ start)[None])
        scale = np.linalg.norm(start, axis=0)
        solution = np.linalg.lstsq(np.vstack(rows) / scale, -here.values, rcond=_RANK)[0]
        step = start @ (solution / scale)
        for k in range(_HALVINGS):
            try:
                found = self.at(self.in_section(here.x + 0.5**k * step))
            except (ValueError, DalembertError):  # it does not return
                continue
            if found.residual < here.residual:
                return found
        return None


def _kernel(rows: Array) -> Array:
    """Return an orthonormal basis of the kernel of independent rows, as columns."""
    size = rows.shape[1]
    if not len(rows):
        return np.eye(size)
    return np.linalg.svd(rows)[2][np.linalg.matrix_rank(rows) :].T


def section(
    system: System,
    g: Any,
    *,
    direction: float = 1.0,
    returning: Iterable[str] | None = None,
    periods: Mapping[str, float] | None = None,
    t_max: float = 1e3,
    tolerance: float | None = None,
) -> Section:
    """Return a Poincare section: the states in D where an expression is zero.

    Parameters
    ----------
    system : System
        With Taylor series, which find all crossings; see the scheme "taylor".
    g : sympy.Expr
        In coordinates, velocities and parameters, as of an `Event`.
    direction : float, optional
        Positive (default): only crossings where g increases; negative: only where it decreases; 0:
        both.
    returning : iterable of str, optional
        The numbers that a periodic orbit has to repeat: names of coordinates, and "v_x" for the
        velocity of x.  Default: all.  Without those that nothing depends on, orbits are periodic up
        to a shift or a rotation.
    periods : mapping of str to float, optional
        The periods of angles, for instance ``{"theta": 2 * math.pi}``.
    t_max : float, optional
        Longest mean time between crossings.
    tolerance : float, optional
        That of the scheme "taylor"; default 1e-15.

    Returns
    -------
    Section
        Has the methods points, map and orbit.

    Examples
    --------
    >>> import dalembert as dal
    >>> x, y = dal.coordinates("x y")
    >>> L = (x.d**2 + y.d**2) / 2 - x**2 / 2 - 2 * y**2
    >>> system = dal.System.from_sympy(L, coordinates=[x, y])
    >>> orbit = dal.section(system, y).orbit([0, 0], [0, 1])
    >>> round(orbit.period, 12), bool(abs(orbit.multipliers[1] + 1) < 1e-12)
    (3.14159265359, True)
    """
    require_system(system)
    if not is_expression(g) or not g.free_symbols:
        raise ValueError(f"g = {arguments.shown(g)}: expected a SymPy expression in the state")
    import sympy

    if any(type(e).__name__ in _JUMPS for e in sympy.preorder_traversal(g)):
        raise ValueError(f"g = {g}: expected an expression without jumps")
    names = [*system.coordinates, *(f"v_{name}" for name in system.coordinates)]
    chosen = names if returning is None else arguments.names(returning, "returning", "names")
    given = dict(periods or {})
    for name, argument in [(x, "returning") for x in chosen] + [(x, "periods") for x in given]:
        if name not in names:
            raise ValueError(
                f"{argument}: {name!r} is unknown; {arguments.suggestion(name, names)}expected "
                f"{', '.join(names)}"
            )
    turns = np.array([_positive(given[name], "periods") if name in given else np.inf
                      for name in chosen])  # fmt: skip
    scheme = Scheme.find("taylor") if tolerance is None else Scheme.taylor(tolerance)
    return Section(
        system, g, arguments.number(direction, "direction"), [names.index(x) for x in chosen],
        turns, _positive(t_max, "t_max"), scheme,
    )  # fmt: skip


def _positive(value: float, name: str) -> float:
    number = arguments.number(value, name)
    if not number > 0.0:
        raise ValueError(f"{name} = {value!r}: expected a positive number")
    return number
