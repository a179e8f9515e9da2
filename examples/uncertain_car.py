"""Where a steered car ends whose masses and length are known to some percent: a Monte Carlo.

Mass, inertias and the distance of the axles are drawn from normal distributions by a quasi-random
sequence.  Each member starts with the initial data that its own parameters give.

Prints mean and standard deviation of the position at the end, and compares the latter with what the
derivatives by the parameters say: a check that shares nothing with the sample.

    python uncertain_car.py [PICTURE.png]
"""

import sys

import numpy as np
from scipy import stats

import dalembert as dal

car = dal.systems.steered_car()
spread = {"m": 0.05, "J": 0.1, "K": 0.1, "l": 0.02}  # relative
ranges = {name: stats.norm(car.parameters[name], x * car.parameters[name])
          for name, x in spread.items()}  # fmt: skip
given = {"h": 0.01, "t_end": 4.0, "progress": False}

cars = dal.ensemble(car, "midpoint", parameters=dal.sample(2048, seed=1, **ranges), **given)
print(cars)
mean, deviation = cars.q.mean(axis=0), cars.q.std(axis=0)
for name, a, b in zip(car.coordinates, mean, deviation):
    print(f"{name:>6} = {a:8.4f} +- {b:.4f}")

# d q/d p by differences, one pair of members for each parameter: to first order the same deviation.
step = np.array([-1e-4, 1e-4])
slopes = []
for name, x in spread.items():
    value = car.parameters[name]
    pair = dal.ensemble(car, "midpoint", parameters={name: value * (1 + step)}, **given)
    slopes.append(np.diff(pair.q, axis=0)[0] / np.diff(step) * x)
linear = np.sqrt(np.sum(np.square(slopes), axis=0))
print("by derivatives:", *(f"{b:.4f}" for b in linear))
assert cars.success.all() and cars.worst_residual.max() < 4 * 4 * 2.0**-53
assert (abs(linear / deviation - 1) < 0.1).all()

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    bands = dal.ensemble(car, "midpoint", parameters=cars.parameters, keep="all", stride=10,
                         **given)  # fmt: skip
    figure, (place, time) = plt.subplots(1, 2, figsize=(10.5, 4.2), layout="constrained")
    place.plot(*bands.q[:200, :, :2].T, color="#0072B2", alpha=0.08, lw=0.8)
    place.plot(*cars.q[:, :2].T, ".", color="#D55E00", ms=2.5)
    place.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="200 ways, and all ends")
    bands.plot("y", ax=time)
    time.set(xlabel="t (s)", ylabel="y (m)", title="y of 2048 cars")
    figure.savefig(sys.argv[1], dpi=110)
