"""The order of the gallery: motions, many runs, what can go wrong, geometry."""

ORDER = [
    "particle", "own_system", "falling_disc", "snakeboard_gait", "roller_racer", "reversing_trailers",
    "ball_on_turntable", "bouncing_sleigh", "driven_robot", "environment",
    "which_wall", "uncertain_car", "swept_step", "many_skates", "killed_run",
    "order", "kept_nodes", "order_lost", "long_runs", "two_maps",
    "embedding", "deformed", "exact_constraints", "charts",
]  # fmt: skip


def place(name: str) -> int:
    """Return the place of a script; one that is not listed is an error."""
    return ORDER.index(name.removesuffix(".py"))
