"""
An uncertain car
================

Mass, inertias and length of a car are known only to some percent.  Two thousand runs show where it
may end.

Mass m, inertias J and K, and the distance l of the axles are drawn from normal distributions by a
quasi-random sequence.  The initial data of each member follow from its own parameters::

    L = (m (v_x^2 + v_y^2) + J v_theta^2 + K (v_theta + v_phi)^2)/2
    -sin(theta) v_x + cos(theta) v_y = 0
    -sin(theta + phi) v_x + cos(theta + phi) v_y + l cos(phi) v_theta = 0

``python uncertain_car.py [PICTURE.png]`` prints mean and standard deviation of the last position.
It compares the deviation with a linear estimate from derivatives by the parameters, a check that is
independent of the sample.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import dalembert as dal
from dalembert.show.palette import COLOURS

car = dal.systems.steered_car()
spread = {"m": 0.05, "J": 0.1, "K": 0.1, "l": 0.02}  # relative
ranges = {
    name: stats.norm(car.parameters[name], x * car.parameters[name]) for name, x in spread.items()
}
given = {"h": 0.01, "t_end": 4.0, "progress": False}

cars = dal.ensemble(car, "midpoint", parameters=dal.sample(2048, seed=1, **ranges), **given)
print(cars)
mean, deviation = cars.q.mean(axis=0), cars.q.std(axis=0)
for name, a, b in zip(car.coordinates, mean, deviation):
    print(f"{name:>6} = {a:8.4f} +- {b:.4f}")

# %%
# The derivatives of q by each parameter follow from differences of a pair of members.  To first
# order they give the same deviation.

step = np.array([-1e-4, 1e-4])
slopes = []
for name, x in spread.items():
    value = car.parameters[name]
    pair = dal.ensemble(car, "midpoint", parameters={name: value * (1 + step)}, **given)
    slopes.append(np.diff(pair.q, axis=0)[0] / np.diff(step) * x)
linear = np.sqrt(np.sum(np.square(slopes), axis=0))
print("by derivatives:", *(f"{b:.4f}" for b in linear))
if not (cars.success.all() and cars.worst_residual.max() < 4 * 4 * 2.0**-53):
    sys.exit("all members were expected to go through, in D to roundoff")
if not (abs(linear / deviation - 1) < 0.1).all():
    sys.exit("the derivatives were expected to give the deviation of the sample")

# %%
# The path of the car with mean parameters, the paths of 200 others in pale blue, and the last
# positions of all.  The length of the car changes how far it turns.

nominal = dal.integrate(car, "midpoint", h=given["h"], t_end=given["t_end"])
bands = dal.ensemble(car, "midpoint", parameters=cars.parameters, keep="all", stride=10, **given)
figure, (place, time) = plt.subplots(
    1, 2, figsize=(10.0, 5.0), width_ratios=(1.15, 1), layout="constrained"
)
place.set(xlabel="x (m)", ylabel="y (m)")
dal.plot.snapshots(nominal, ax=place, count=6)
place.plot(*bands.q[:200, :, :2].T, color=COLOURS[0], alpha=0.08, linewidth=0.8)
place.plot(*cars.q[:, :2].T, ".", color=COLOURS[2], markersize=2.5, zorder=3)
place.set_title("200 ways, and all ends", loc="left")
bands.plot("y", ax=time)
time.set(xlabel="t (s)", ylabel="y (m)", title="y of 2048 cars")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
