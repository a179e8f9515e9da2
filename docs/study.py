"""Draws the pictures of the first pages: `./dev shell python docs/study.py`.

The film docs/trailers.gif, and docs/study.png.  Its upper panel is the study of six schemes on the
nonholonomic particle: the error at t = 4 against the step, with the fitted orders.  Below are the
residuals of `midpoint` at moved nodes (D) and at kept nodes (D_eps).
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import dalembert as dal

SCHEMES = ["explicit", "midpoint", "midpoint-nodes"] + [
    f"leapfrog-{composition}" for composition in ("suzuki4", "kl6", "kl8")
]

particle = dal.systems.particle()
studies = dal.studies(particle, SCHEMES, t_end=4.0)
runs = [
    dal.integrate(particle, "midpoint", h=0.05, t_end=20.0),
    dal.integrate(particle, "midpoint-nodes", h=0.05, t_end=20.0, initial="project"),
]
styles = dal.plot.styles(SCHEMES)

figure = plt.figure(figsize=(12.0, 8.0), layout="constrained")
above, below = figure.subfigures(2, 1, height_ratios=[1.25, 1.0])
dal.plot.convergence(studies, ax=above.subplots(), styles=styles)
dal.plot.drift(runs, ax=below.subplots(1, 2, sharey=True), styles=styles)
figure.savefig(Path(__file__).with_name("study.png"), dpi=90, metadata={"Software": None})

trailers = dal.integrate(dal.systems.n_trailer(), "leapfrog", h=0.02, t_end=9)
dal.plot.animate(trailers, fps=15, seconds=5).save(Path(__file__).with_name("trailers.gif"))
