"""Nonholonomic mechanics and its structure-preserving integrators.

A system is a triple (Q = R^n, L, D), such as ``L = v^T M v / 2 - V(q)`` and ``D = {mu(q) v = 0}``.
The integrators discretise the Lagrange-d'Alembert principle, after F. Jimenez and J. Scheurle, "On
the discretization of nonholonomic dynamics in R^n" (arXiv 1407.2116).  They preserve D, or a known
deformation of it, to roundoff.

>>> import dalembert as dal
>>> run = dal.integrate(dal.systems.particle(), "midpoint", h=0.01, t_end=10)
>>> bool(run.residual.max() < 1e-15)
True
"""

import logging
from typing import Any

from . import compiler, core, geometry, growth, symbolic, systems
from .core import (
    ConvergenceError,
    DalembertError,
    DalembertWarning,
    DomainError,
    JournalError,
    NotOnConstraintError,
    SingularError,
    ZenoError,
    pointers,
)
from .discrete import DifferenceMap, Discrete, NodeRun, Regularity, exact_velocity
from .ensembles import Design, Ensemble, StoreError, ensemble, grid, open_ensemble, sample
from .geometry import Chart, Check, Difference
from .run import (
    Event,
    Reference,
    Scheme,
    Solution,
    States,
    Statistics,
    Stepper,
    Variations,
    integrate,
    load,
    reference,
    resume,
    schemes,
    variations,
)
from .show import animation, bodies, notebook, pages, plot, report, table
from .show import ensembles as pictures
from .study import (
    Embedding,
    Fit,
    Orbit,
    Recommendation,
    Return,
    Section,
    Studies,
    Study,
    Tried,
    convergence,
    embedding,
    recommend,
    section,
    studies,
)
from .symbolic import coordinates
from .system import System

__version__ = core.version()

__all__ = [
    "Chart",
    "Check",
    "ConvergenceError",
    "Design",
    "DalembertError",
    "DalembertWarning",
    "Difference",
    "DifferenceMap",
    "Discrete",
    "DomainError",
    "Embedding",
    "Ensemble",
    "Event",
    "Fit",
    "JournalError",
    "NodeRun",
    "NotOnConstraintError",
    "Orbit",
    "Recommendation",
    "Reference",
    "Regularity",
    "Return",
    "Scheme",
    "Section",
    "SingularError",
    "Solution",
    "States",
    "Statistics",
    "Stepper",
    "StoreError",
    "Studies",
    "Study",
    "System",
    "Tried",
    "Variations",
    "ZenoError",
    "convergence",
    "coordinates",
    "embedding",
    "ensemble",
    "exact_velocity",
    "geometry",
    "grid",
    "integrate",
    "load",
    "open_ensemble",
    "pages",
    "plot",
    "recommend",
    "reference",
    "report",
    "resume",
    "sample",
    "schemes",
    "section",
    "studies",
    "systems",
    "variations",
]

# What objects show of themselves: below `show` nothing knows of tables and pictures.
table.attach(Study, table.study_lines, table.of_study)
table.attach(Studies, table.studies_lines, table.overview)
plot.animate, plot.snapshots, plot.bodies = animation.animate, animation.snapshots, bodies
Study.plot = Studies.plot = plot.convergence
Embedding.plot = plot.embedded
Ensemble.plot, Ensemble._repr_html_ = pictures.draw, pictures.page
notebook.attach()

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Return `time`, the symbol of the time in expressions, which needs SymPy."""
    if name == "time":
        return symbolic.symbols.Time()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
