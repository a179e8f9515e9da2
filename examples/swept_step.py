"""
A sweep on two processes
========================

Every step size of a sweep is a member of an ensemble, on any executor, here on two processes.  The
last states converge to the exact one with the order of the scheme.

A skate on a slope (the knife edge), by three schemes of order 2, 4 and 6.  Two processes of dask
compute the members if it is installed (``pip install '.[cluster]'``), otherwise a process pool.
Results go into a store: after any interruption, the same call resumes and reads the stored results.
On a cluster, only the client changes, to ``Client("tcp://HOST:PORT")``::

    dal.ensemble(system, scheme, h=steps, t_end=8, executor=executor, store=folder)

``python swept_step.py [PICTURE.png]`` prints the errors, the measured order, and the residual of D
of each scheme.
"""

import contextlib
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

edge = dal.systems.knife_edge()
t_end, h = 8.0, 8.0 / np.array([25, 50, 100, 200, 400, 800, 1600])
schemes = {"midpoint": 2, "leapfrog-yoshida4": 4, "leapfrog-kl6": 6}


@contextlib.contextmanager
def two_processes():
    """Provide an executor, and end its processes afterwards."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        with ProcessPoolExecutor(2) as pool:
            yield pool
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            with Client(cluster) as client:
                yield client.get_executor(pure=False)


# %%
# New processes import this file too.  ``__name__`` differs in them, so they stop here, and start no
# processes of their own.

if __name__ == "__main__":
    exact, _ = edge.exact(t_end)
    errors, ensembles = {}, {}
    with two_processes() as executor, tempfile.TemporaryDirectory() as folder:
        for scheme, order in schemes.items():
            given = {"h": h, "t_end": t_end, "progress": False, "store": f"{folder}/{scheme}"}
            runs = dal.ensemble(edge, scheme, executor=executor, block=2, **given)
            there = dal.open_ensemble(f"{folder}/{scheme}")
            error = errors[scheme] = np.linalg.norm(there.q - exact, axis=1)
            slope = np.polyfit(np.log(h[error > 1e-9]), np.log(error[error > 1e-9]), 1)[0]
            worst = there.worst_residual.max()
            print(
                f"{scheme:>18}: error {error[0]:.1e} to {error[-1]:.1e}, order {slope:.2f}, "
                f"residual of D {worst:.1e}"
            )
            # The bits equal those of a run in this process, and those in the store.
            here = ensembles[scheme] = dal.ensemble(edge, scheme, **given | {"store": None})
            if not ((here.q == runs.q).all() and (there.q == runs.q).all()):
                sys.exit("expected the same members from every process")
            if abs(slope - order) > 0.3:
                sys.exit(f"order {order} was expected")

# %%
# Above: the last arc of the path for two members with ``midpoint``.  The skate moves down the
# slope, its rotation turns it, and it moves up again; with long steps it ends elsewhere.  Below:
# the errors of all members.

if __name__ == "__main__":
    figure, (way, ax) = plt.subplots(
        2, 1, figsize=(7.6, 6.8), height_ratios=(1, 1.25), layout="constrained"
    )
    path = np.array([edge.exact(t)[0] for t in np.linspace(0, t_end, 500)])
    way.plot(path[:, 1], path[:, 0], color="0.6", linewidth=1, label="exact")
    for k, colour in ((0, COLOURS[4]), (2, COLOURS[6])):
        x, y, heading = ensembles["midpoint"].member(k).q.T[:, :: 1 if k == 0 else 4]
        along = 0.12 * np.array([np.cos(heading), np.sin(heading)])
        blades = [y - along[1], y + along[1]], [x - along[0], x + along[0]]
        label = [f"h = {h[k]:g} s"] + [None] * (len(x) - 1)
        way.plot(*blades, color=colour, linewidth=5, label=label)
    way.plot(path[-1, 1], path[-1, 0], "*", color=COLOURS[1], markersize=18, label="exact end")
    way.set(xlabel="y, across the slope (m)", ylabel="x, downhill (m)", aspect="equal")
    way.set(xlim=(5.2, 8.85), ylim=(1.1, -0.3))
    way.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for style, (scheme, error) in zip(dal.plot.styles(errors).values(), errors.items()):
        ax.loglog(h, error, label=f"{scheme}, order {schemes[scheme]}", **style)
    ax.set(xlabel="h (s)", ylabel=f"error of q at t = {t_end:g} s (m, rad)")
    ax.legend(frameon=False)
    if len(sys.argv) > 1:
        figure.savefig(sys.argv[1], dpi=110)
