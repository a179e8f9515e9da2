"""A sweep over the step on two processes: errors and residuals of three schemes, as orders show.

Two processes of dask make the members where it is installed (pip install '.[cluster]'), else those
of a pool.  Results go into a store: whatever ends this program, the same call goes on, and reads
what is there.  On a cluster ``Client("tcp://HOST:PORT")`` is all that changes.

    python swept_step.py [PICTURE.png]
"""

import contextlib
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import dalembert as dal

edge = dal.systems.knife_edge()
t_end, h = 8.0, 8.0 / np.array([25, 50, 100, 200, 400, 800, 1600])
exact, _ = edge.exact(t_end)


@contextlib.contextmanager
def two_processes():
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        with ProcessPoolExecutor(2) as pool:
            yield pool
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            with Client(cluster) as client:
                yield client.get_executor(pure=False)


def main():
    errors = {}
    with two_processes() as executor, tempfile.TemporaryDirectory() as folder:
        for scheme, order in (("midpoint", 2), ("leapfrog-yoshida4", 4), ("leapfrog-kl6", 6)):
            given = {"h": h, "t_end": t_end, "progress": False, "store": f"{folder}/{scheme}"}
            runs = dal.ensemble(edge, scheme, executor=executor, block=2, **given)
            there = dal.open_ensemble(f"{folder}/{scheme}")
            error = errors[scheme] = np.linalg.norm(there.q - exact, axis=1)
            slope = np.polyfit(np.log(h[error > 1e-9]), np.log(error[error > 1e-9]), 1)[0]
            print(f"{scheme:>18}: error {error[0]:.1e} to {error[-1]:.1e}, order {slope:.2f}, "
                  f"residual of D {there.worst_residual.max():.1e}")  # fmt: skip
            here = dal.ensemble(edge, scheme, **given | {"store": None})
            assert (here.q == runs.q).all() and (there.q == runs.q).all()
            assert abs(slope - order) < 0.3

    if len(sys.argv) > 1:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        figure, ax = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
        for style, (scheme, error) in zip(dal.plot.styles(errors).values(), errors.items()):
            ax.loglog(h, error, label=scheme, **style)
        ax.set(xlabel="h (s)", ylabel=f"error of q at t = {t_end:g} s (m, rad)",
               title="knife edge, by two processes")  # fmt: skip
        ax.legend(frameon=False)
        figure.savefig(sys.argv[1], dpi=110)


if __name__ == "__main__":
    main()
