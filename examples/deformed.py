"""A deformed constraint, and what its reaction does to the energy.

    D        v_z - y v_x = 0
    D_delta  v_z - y v_x + delta v_x v_y = 0

A free particle.  On D the reaction does no work and the energy is constant.  On D_delta, which is
no subspace of the velocities, the reaction along d(phi)/dv has the power lambda delta v_x v_y: the
energy changes, with delta, by what the reaction does.  For delta = h/2, D_delta is the D_eps in
which the midpoint scheme with kept nodes stays.

Prints the change of the energy, the work of the reaction, and the largest |phi|, for several delta.

    python deformed.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

particle = dal.systems.particle()
h, t_end = 0.01, 6.0


def on_D(delta):
    """Return the particle with its constraint deformed by delta v_x v_y."""
    return particle.deformed(
        lambda q, v: [v[0] * v[1]],
        delta,
        g_v=lambda q, v: [[v[1], v[0], 0.0]],
        g_q=lambda q, v: np.zeros((1, 3)),
    )


found = {}
print("delta    E(t_end) - E(0)    work of the reaction    largest |phi|")
for delta in (0.0, 0.05, 0.1, 0.2):
    system = on_D(delta)
    v0 = system.project(particle.q0, particle.v0)
    run = dal.integrate(system, "reference", particle.q0, v0, h=h, t_end=t_end)
    power, _ = system.power(run.q, run.v)
    # Simpson's rule, of order 4 in h.
    work = h / 3 * (power[0] + power[-1] + 4 * power[1::2].sum() + 2 * power[2:-1:2].sum())
    gain = run.energy - run.energy[0]
    worst = abs(system.residual(run.q, run.v)).max()
    print(f"{delta:5g}    {gain[-1]:15.10f}    {work:20.10f}    {worst:13.1e}")
    if abs(gain[-1] - work) > 1e-9 or worst > 1e-14 or (delta == 0.0) != (gain[-1] < 1e-12):
        sys.exit("the energy was expected to change by the work of the reaction, on D_delta only")
    found[delta] = run.t, gain, power

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    for (delta, (t, gain, power)), line in zip(found.items(), ("-", "--", "-.", ":")):
        label = f"$\\delta$ = {delta:g}" if delta else "$\\delta$ = 0, on $D$"
        (drawn,) = axes[0].plot(t, gain, linestyle=line)
        axes[1].plot(t, power, linestyle=line, color=drawn.get_color(), label=label)
        few = slice(10, None, 45)
        slope = np.gradient(gain, t)
        circles = {"marker": "o", "markerfacecolor": "none", "color": drawn.get_color()}
        axes[1].plot(t[few], slope[few], linestyle="none", **circles)
    axes[1].plot([], [], linestyle="none", marker="o", markerfacecolor="none", color="black",
                 label="dE/dt by differences")  # fmt: skip
    for ax in axes:
        ax.set_xlabel("time t (user's units)")
    axes[0].set_ylabel("E - E(0) (user's units)")
    axes[0].set_title("energy")
    axes[1].set_ylabel("power (user's units)")
    axes[1].set_title("power of the reaction")
    axes[1].legend(frameon=False)
    figure.suptitle("Free particle on $D_\\delta$: $v_z - y v_x + \\delta v_x v_y = 0$")
    figure.savefig(sys.argv[1], dpi=110)
