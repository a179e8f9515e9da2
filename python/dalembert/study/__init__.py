"""Orders of schemes, measured; which of them is best; and their perturbed flows."""

from .embeddings import Embedding, embedding
from .recommendation import Recommendation, Tried, recommend
from .refinement import convergence, studies
from .section import Orbit, Return, Section, section
from .study import Fit, Studies, Study
