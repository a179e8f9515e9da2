"""Orders of schemes, measured; and schemes as the period maps of perturbed flows."""

from .embeddings import Embedding, embedding
from .refinement import convergence, studies
from .study import Fit, Studies, Study
