"""Are there better compositions than the records of the library?  A search, and a comparison.

Not a publication.  The records `bm4`, `bm6`, `kl6`, `kl8`, `ss10`, `suzuki4` are by authors who had
separable Hamiltonians or any symmetric map in mind.  Here a stage is a leapfrog, or a pair of
`explicit` and `endpoint`: one gradient and one solve with m unknowns, whatever its fraction.

Classes: symmetric compositions of n leapfrogs; symmetric compositions of n pairs; and both as
kernels K of a processed composition pi K^N pi^-1, where pi, made of stages too, stands at the start
and at the end of a run only, so that K has fewer conditions (Blanes, Casas, Murua, SIAM J. Sci.
Comput. 27 (2006) 1817).  All maps keep D.

Search: a map of first order is exp(g Y_1 + g^2 Y_2 + ...), its adjoint the inverse at -g, a
symmetric one has no even Y; nothing is known of the Y, so a composition is a series in words of
them.  Conditions: the logarithm is Y_1 up to the order, but for [P, Y_1] in a kernel, which pi
removes.  From random starts Gauss-Newton finds solutions, and goes down along them in the length of
the first terms that are left, a word counting by its letters: 1/24, 3/640, ... for Y_3, Y_5, ...
(the leapfrog of an oscillator), 1/k! for the Y_k of pairs.  Of the best solutions of a class the
one is taken that has the least errors on four systems of training.

Comparison: the error of the state at t = 100 of other systems over the number of stages, against
the least error of the records of that order at the same number; the gain is the median of the ratio
over the useful range, where the record has an error of 1e-11 to 1e-2 of the state.

Few starts are made, so that the search takes minutes: of order 8 it misses `kl8` itself, which is
the best of 17 leapfrogs in longer searches, to 0.1 % of what is minimised; 19 and 21 leapfrogs had
nothing smaller at equal work.  A search of two processor hours went through kernels of order 10, of
17 to 27 leapfrogs, too: in the first terms that are left they are down to 0.8 of `ss10` at equal
work, but their fractions reach 0.6, where those of higher order take over, and on four of the
systems the errors of the best, of 25, are 1.3 to 40 times those of `ss10`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from scipy.optimize import least_squares

import dalembert as dal

Array = np.ndarray

# order, stages, pairs, processed, solutions to be found
FULL = [(4, 7, False, False, 8), (4, 6, True, False, 12), (4, 7, True, False, 12),
        (4, 8, True, False, 12), (4, 5, False, True, 8), (4, 3, True, True, 8),
        (4, 4, True, True, 8), (4, 5, True, True, 8), (6, 9, False, False, 8),
        (6, 11, False, False, 8), (6, 13, False, False, 6), (6, 10, True, False, 8),
        (6, 11, True, False, 6), (6, 12, True, False, 4), (6, 7, False, True, 8),
        (6, 9, False, True, 8), (6, 6, True, True, 4), (6, 7, True, True, 6),
        (8, 17, False, False, 4), (8, 19, False, False, 4), (8, 21, False, False, 4),
        (8, 11, False, True, 4), (8, 13, False, True, 4)]  # fmt: skip
QUICK = [(4, 6, True, False, 2), (4, 4, True, True, 2)]
RECORDS = {4: ("bm4", "leapfrog-suzuki4"), 6: ("bm6", "leapfrog-kl6"),
           8: ("leapfrog-kl8", "leapfrog-ss10")}  # fmt: skip
TRAINING = ("particle", "disk", "sleigh", "chaotic")
JUDGES = ("knife_edge", "particle_oscillator", "contact_oscillator", "heisenberg", "robot",
          "sleigh_contact", "genmass", "rolling_disc", "ball_on_table", "n_trailer")  # fmt: skip
LARGEST = 1.2  # of the fractions
GAIN, WINS = 1.5, len(JUDGES) // 2 + 1  # what a new record would need, with the knife edge
GAINS = ("order 4, 5 pairs, processed",)  # what has it


# ---- series ------------------------------------------------------------------------------------


class Words:
    """Series in the words of Y_k up to a degree: arrays of their coefficients."""

    def __init__(self, letters: Sequence[int], top: int) -> None:
        words: list[tuple[int, ...]] = [()]
        for word in words:
            words += [(*word, k) for k in letters if sum(word) + k <= top]
        words.sort(key=lambda word: (sum(word), word))
        at = {word: i for i, word in enumerate(words)}
        cuts = [(i, at[word[:k]], at[word[k:]])
                for i, word in enumerate(words) for k in range(len(word) + 1)]  # fmt: skip
        self._whole, self._left, self._right = np.array(cuts).T
        self.words, self.top, self.size = words, top, len(words)
        self.degree = np.array([sum(word) for word in words])
        self.exp_of_sum = 1 / np.array([math.factorial(len(word)) for word in words])
        self.sign = np.array([(-1.0) ** sum(k - 1 for k in word) for word in words])
        self.one, self.y1 = np.eye(self.size)[[0, at[(1,)]]]
        self.flow = self.exp(self.y1)
        length = {1: 1.0, 3: 1 / 24, 5: 3 / 640, 7: 5 / 7168, 9: 35 / 294912}
        if 2 in letters:
            length = {k: 1 / math.factorial(k) for k in letters}
        self.length = np.array([math.prod(length[k] for k in word) for word in words])

    def mul(self, x: Array, y: Array) -> Array:
        """Return the product."""
        return np.bincount(self._whole, x[self._left] * y[self._right], self.size)

    def bracket(self, x: Array, y: Array) -> Array:
        """Return the commutator."""
        return self.mul(x, y) - self.mul(y, x)

    def exp(self, x: Array) -> Array:
        """Return the exponential."""
        total, power = self.one.copy(), self.one
        for k in range(1, self.top + 1):
            power = self.mul(power, x) / k
            total += power
        return total

    def log(self, x: Array) -> Array:
        """Return the logarithm."""
        rest, total, power = x - self.one, np.zeros(self.size), self.one
        for k in range(1, self.top + 1):
            power = self.mul(power, rest)
            total += (-1) ** (k + 1) * power / k
        return total

    def composition(self, fractions: Iterable[float], pairs: bool) -> Array:
        """Return the series of stages one after the other, or of the two maps in turn."""
        total = self.one
        for i, g in enumerate(fractions):
            sign = self.sign if pairs and i % 2 else 1.0
            total = self.mul(total, self.exp_of_sum * g**self.degree * sign)
        return total

    def brackets(self, degree: int) -> Array:
        """Return a basis of the Lie elements of a degree, as columns."""
        columns = []
        for word in self.words:
            if word and sum(word) == degree:
                letters = [np.eye(self.size)[self.words.index((k,))] for k in word]
                x = letters.pop()
                while letters:
                    x = self.bracket(letters.pop(), x)
                columns.append(x)
        u, s, _ = np.linalg.svd(np.array(columns).T, full_matrices=False)
        return u[:, s > 1e-10 * s[0]]


# ---- search ------------------------------------------------------------------------------------


class Class:
    """The compositions of an order, by the fractions of their first half."""

    def __init__(self, order: int, stages: int, pairs: bool, processed: bool) -> None:
        letters = range(1, order + 2) if pairs else range(1, order + 2, 2)
        self.order, self.stages, self.pairs, self.processed = order, stages, pairs, processed
        self.words = words = Words(letters, order + 1)
        count = 2 * stages if pairs else stages
        self.free = (count + 1) // 2
        self._unfold = np.eye(self.free)[np.minimum(np.arange(count), np.arange(count)[::-1])]
        self._removal = [self._remove(degree) for degree in range(1, order + 2, 2)]

    def _remove(self, degree: int) -> tuple[Array, Array, Array, Array]:
        """Return the words of a degree, a basis of P, their [P, Y_1], and a basis of the rest."""
        words = self.words
        chosen = words.degree == degree
        length = words.length[chosen, None]
        p = np.zeros((words.size, 0))
        if self.processed and degree > 1 and (words.degree == degree - 1).any():
            p = words.brackets(degree - 1)
        removed = np.array([words.bracket(x, words.y1) for x in p.T]).reshape(-1, words.size)
        removed = removed.T[chosen] * length
        rest = words.brackets(degree)[chosen] * length
        if p.size:
            q = np.linalg.qr(removed)[0]
            rest = rest - q @ (q.T @ rest)
        u, s, _ = np.linalg.svd(rest, full_matrices=False)
        return chosen, p, removed, u[:, s > 1e-9 * words.length[chosen].max()]

    def fractions(self, x: Array) -> Array:
        """Return all of them."""
        return self._unfold @ x

    def errors(self, x: Array) -> tuple[Array, Array]:
        """Return what has to be 0, and the first terms that are left."""
        words, conditions, left = self.words, [], np.zeros(0)
        log = words.log(words.composition(self.fractions(x), self.pairs))
        for (chosen, p, removed, rest), degree in zip(self._removal, range(1, self.order + 2, 2)):
            error = ((log - words.y1) * words.length)[chosen]
            left = rest.T @ error
            if degree > self.order:
                break
            conditions.append(left)
            if p.size:
                by = p @ np.linalg.lstsq(removed, -error, rcond=1e-10)[0]
                moved = words.mul(words.mul(words.exp(by), words.exp(log)), words.exp(-by))
                log = words.log(moved)
        return np.concatenate(conditions), left

    def slopes(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return both, each with its Jacobian."""
        steps = 1e-6 * np.eye(self.free)
        sides = [(self.errors(x + d), self.errors(x - d)) for d in steps]
        one, two = (np.array([(a[k] - b[k]) / 2e-6 for a, b in sides]).T for k in (0, 1))
        conditions, left = self.errors(x)
        return conditions, one, left, two

    def solve(self, x: Array, most: int = 25) -> Array | None:
        """Return a solution near x by Gauss-Newton, None if there is none with small fractions."""
        for i in range(most):
            conditions, slope, _, _ = self.slopes(x)
            size = np.abs(conditions).max()
            if size < 1e-13:
                return x if np.abs(x).max() < LARGEST else None
            if not np.isfinite(size) or np.abs(x).max() > 4 or (i == 12 and size > 1e-2):
                return None
            step = np.linalg.lstsq(slope, conditions, rcond=1e-10)[0]
            x = x - step * min(1.0, 0.5 / np.abs(step).max())
        return None

    def value(self, x: Array) -> float:
        """Return the error at equal work, to the power 1/order."""
        return float(self.stages * np.linalg.norm(self.errors(x)[1]) ** (1 / self.order))

    def descend(self, x: Array) -> Array:
        """Return the solution that x leads to along the solutions, by Levenberg and Marquardt."""
        value, damping = self.value(x), 1e-2
        for _ in range(30):
            _, slope, left, change = self.slopes(x)
            _, s, v = np.linalg.svd(slope)
            along = v[(s > 1e-9 * s[0]).sum() :].T
            if along.shape[1] == 0:
                return x
            change = change @ along
            normal = change.T @ change
            for _ in range(6):
                shift = damping * np.trace(normal) / len(normal) * np.eye(len(normal))
                step = along @ -np.linalg.solve(normal + shift, change.T @ left)
                y = self.solve(x + step * min(1.0, 0.1 / np.abs(step).max()), 6)
                if y is not None and self.value(y) < value:
                    break
                damping *= 6
            else:
                return x
            x, damping, before, value = y, damping / 4, value, self.value(y)
            if before - value < 1e-4 * value:
                break
        return x

    def search(self, count: int, random: np.random.Generator) -> list[Array]:
        """Return different solutions, the best first, of so many that were found."""
        found: list[tuple[float, Array]] = []
        tries = hits = 0
        while hits < count and tries < 60 * count:
            tries += 1
            x = random.normal(size=self.free) * random.choice([0.2, 0.4, 0.7])
            start = self.solve(x + (1 - self._unfold.sum(0) @ x) / len(self._unfold))
            if start is None:
                continue
            hits += 1
            x = self.descend(start)
            if all(np.abs(x - y).max() > 1e-3 for _, y in found):
                found.append((self.value(x), x))
        return [x for _, x in sorted(found, key=lambda pair: pair[0])]

    def processor(self, x: Array, random: np.random.Generator) -> Array | None:
        """Return the fractions of pi, whose sum is 0: pi^-1 K pi is the flow up to the order."""
        words, order = self.words, self.order
        kernel = words.composition(self.fractions(x), self.pairs)
        weight = words.length * np.where(words.degree <= order, 1e3, 1.0)
        count = {(4, 0): 6, (4, 1): 10, (6, 0): 10, (6, 1): 26, (8, 0): 18}[order, int(self.pairs)]

        def rest(c: Array) -> Array:
            pi = words.composition(c, self.pairs)
            return weight * (words.mul(kernel, pi) - words.mul(pi, words.flow))

        def residuals(c: Array) -> Array:
            return np.concatenate([rest(c), 1e-4 * c, [1e3 * c.sum()]])

        def slopes(c: Array) -> Array:
            sides = [(residuals(c + d), residuals(c - d)) for d in 1e-6 * np.eye(count)]
            return np.array([(a - b) / 2e-6 for a, b in sides]).T

        best: tuple[float, Array | None] = (np.inf, None)
        for _ in range(4):
            start = random.normal(size=count) * random.choice([0.1, 0.2, 0.4])
            c = least_squares(residuals, start, slopes, method="lm", max_nfev=60).x
            r = rest(c)
            if np.abs(r[words.degree <= order]).max() < 1e-3 and np.abs(c).sum() < 6:
                best = min(best, (float(np.linalg.norm(r)), c), key=lambda pair: pair[0])
        return best[1]


# ---- comparison --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Problem:
    """A system, where it starts and where it is at the end."""

    name: str
    system: dal.System
    q: Array
    v: Array
    t_end: float
    end: Array


class Method:
    """A composition that runs; with a processor as three schemes, each of a whole step."""

    def __init__(self, fractions: Array, pairs: bool, processor: Array | None = None) -> None:
        kernel = self._substeps(fractions, pairs)
        self.stages, self.more = len(fractions) / (1 + pairs), 0.0
        self._parts = [kernel]
        if processor is not None:
            after = self._substeps(processor, pairs)
            before = [(1 - beta, -g) for beta, g in reversed(after)]
            self.more = 2 * len(processor) / (1 + pairs)
            self._parts = [before + kernel, kernel, kernel + after]
        self._schemes = [dal.Scheme(self._rounded(part)) for part in self._parts]

    @classmethod
    def of(cls, name: str) -> Method:
        """Return a record of the library."""
        fractions = np.array([g for _, g in dal.Scheme.find(name).substeps])
        pairs = not name.startswith("leapfrog")
        return cls(fractions if pairs else fractions.reshape(-1, 2).sum(1), pairs)

    @staticmethod
    def _substeps(fractions: Array, pairs: bool) -> list[tuple[float, float]]:
        if pairs:
            return [(float(i % 2), float(g)) for i, g in enumerate(fractions)]
        return [(beta, float(g) / 2) for g in fractions for beta in (0.0, 1.0)]

    @staticmethod
    def _rounded(substeps: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """Return them with a sum of 1."""
        beta, g = substeps[0]
        return [(beta, g + 1 - math.fsum(g for _, g in substeps)), *substeps[1:]]

    def error(self, problem: Problem, steps: int) -> float:
        """Return the error at the end, NaN if the run fails."""
        q, v, h = problem.q, problem.v, problem.t_end / steps
        plan = [(self._schemes[0], steps)]
        if self.more:
            plan = [*zip(self._schemes, (1, steps - 2, 1))]
        try:
            for scheme, n in plan:
                run = dal.integrate(
                    problem.system, scheme, q0=q, v0=v, h=h, steps=n, stride=n, check_h=False
                )
                q, v = run.q[-1], run.v[-1]
        except dal.DalembertError:
            return math.nan
        return float(np.abs(np.concatenate([q, v]) - problem.end).max())

    def curve(self, problem: Problem, works: Array) -> tuple[Array, Array]:
        """Return numbers of stages, near ``works``, and the errors over the size of the state."""
        steps = np.unique(np.maximum(np.rint((works - self.more) / self.stages), 3)).astype(int)
        errors = [self.error(problem, int(n)) for n in steps]
        return steps * self.stages + self.more, np.array(errors) / np.abs(problem.end).max()


def problem(name: str, t_end: float, faster: float = 1.0) -> Problem:
    """Return the system with its own data, the velocities ``faster``, and its end by order 10."""
    system = dal.systems.get(name)
    q, v = np.array(system.q0), faster * np.array(system.v0)
    steps = round(t_end / 0.05)
    run = dal.integrate(
        system, "leapfrog-ss10", q0=q, v0=v, h=0.05, steps=steps, stride=steps, check_h=False
    )
    return Problem(name, system, q, v, t_end, np.concatenate([run.q[-1], run.v[-1]]))


Curve = tuple[Array, Array]


def gain(records: Sequence[Curve], new: Curve) -> float:
    """Return how many times less the error of the new one is, the median over the useful range."""

    def at(curve: Curve) -> Array:
        work, error = curve
        seen = np.isfinite(error)
        inside = seen.any() and (works >= work[seen].min()) & (works <= work[seen].max())
        logs = np.interp(np.log(works), np.log(work[seen]), np.log(error[seen]))
        return np.where(inside, logs, np.nan)

    works = np.geomspace(records[0][0][0], records[0][0][-1], 100)
    old = np.nanmin([at(curve) for curve in records], axis=0)
    useful = (old > math.log(1e-11)) & (old < math.log(1e-2))
    ratios = (old - at(new))[useful]
    ratios = ratios[np.isfinite(ratios)]
    return float(np.exp(np.median(ratios))) if len(ratios) else math.nan


class Contest:
    """The records of the orders on some problems, and what others gain over them."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = problems
        per_time = {4: (5, 200), 6: (7, 200), 8: (9, 200)}
        self.works = {order: np.geomspace(*ends, 16) for order, ends in per_time.items()}
        self.curves = {
            (name, problem.name): Method.of(name).curve(problem, self._works(order, problem))
            for order, names in RECORDS.items()
            for name in names
            for problem in problems
        }

    def _works(self, order: int, problem: Problem) -> Array:
        return self.works[order] * problem.t_end

    def gains(self, method: Method, order: int) -> list[float]:
        """Return the gain over the best record of this order, on each problem."""
        return [
            gain([self.curves[name, problem.name] for name in RECORDS[order]],
                 method.curve(problem, self._works(order, problem)))
            for problem in self.problems
        ]  # fmt: skip


def best_of(
    kind: Class, count: int, training: Contest, random: np.random.Generator
) -> Method | None:
    """Return the composition of a class that does best in training."""
    best: tuple[float, Method | None] = (-math.inf, None)
    for x in kind.search(count, random)[:6]:
        processor = kind.processor(x, random) if kind.processed else None
        if processor is None and kind.processed:
            continue
        method = Method(kind.fractions(x), kind.pairs, processor)
        mean = float(np.nanmean(np.log(training.gains(method, kind.order))))
        best = max(best, (mean, method), key=lambda pair: pair[0])
    return best[1]


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Search, compare, and return the rows and the gains."""
    warnings.simplefilter("ignore")  # long steps lose energy
    random = np.random.default_rng(1)
    training = Contest([problem(name, 20.0, 0.8) for name in TRAINING[: 2 if quick else None]])
    judges = Contest([problem(name, 100.0) for name in JUDGES[: 2 if quick else None]])
    rows, found = [], {}
    for order, stages, pairs, processed, count in QUICK if quick else FULL:
        method = best_of(Class(order, stages, pairs, processed), count, training, random)
        name = f"order {order}, {stages} {'pairs' if pairs else 'leapfrogs'}"
        name += ", processed" if processed else ""
        if method is None:
            rows.append(common.holds(name, "-", "no solution", True, "of the starts"))
            continue
        gains = found[name] = np.array(judges.gains(method, order))
        wins = int((gains >= GAIN).sum())
        said = ", ".join(f"{g:.2g}" for g in gains)
        new = wins >= WINS and gains[0] >= GAIN
        verdict = "enough gains" if name in GAINS else "too few gains for a record"
        rows.append(common.holds(name, "-", f"gains {said}", new == (name in GAINS), verdict))
    return rows, found


def draw(found: dict[str, Array]) -> Any:
    """Return a figure of the gains: a row of points for each class."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 0.3 * len(found) + 1.2), layout="constrained")
    axes = figure.subplots()
    for place, gains in enumerate(found.values()):
        axes.plot(gains, np.full(len(gains), place), "o", color="0.6", ms=4)
        axes.plot(gains[:1], [place], "o", color="C3", ms=5, label="" if place else "knife edge")
    axes.axvline(GAIN, color="0.3", lw=1, ls="--", label=f"{GAIN}")
    axes.set(xscale="log", xlabel="error of the best record over that of the new composition")
    axes.set_yticks(range(len(found)), found)
    axes.invert_yaxis()
    axes.legend(frameon=False, loc="upper left")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
