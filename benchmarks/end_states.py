"""End states of every system, scheme and compilation, for whoever moves code of the steps.

    ./dev shell python benchmarks/end_states.py states.json

This writes the file, or, where there is one, says which states differ from those in it.

A state is a digest of (t, q, v, reactions) after some hundred steps, or the name of the error.  It
depends on the compiler and on the math library, so such a file stays on one machine.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import dalembert as dal
from dalembert.core import lib

sys.path[:0] = [str(Path(__file__).parents[1] / "tests/python" / x) for x in ("", "system")]
from test_twins import TWINS, pair_of  # noqa: E402

H, STEPS = 0.02, 200
SCHEMES = [*(scheme.name for scheme in dal.schemes()), "0.3", "0.3-nodes"]
CONTROLS: dict[str, dict[str, Any]] = {
    "auto": {"h": "auto", "tolerance": 1e-7, "t_end": 2.0},
    "reversible": {"h": "reversible", "eps": 0.02, "t_end": 1.0},
    "energy": {"h": H, "steps": STEPS, "energy": "keep"},
    "rows": {"h": H, "steps": STEPS, "stride": 7, "t_eval": [0.0, 1.0, 1.23, 3.9]},
}


def digest(*arrays: Any) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in arrays)).hexdigest()


def stepped(system: dal.System, start: Any, scheme: str, any_sizes: bool) -> str:
    kept = "project" if "nodes" in scheme else None
    stepper = dal.Stepper(system, scheme, *start, h=H, consistent="project", initial=kept)
    if any_sizes:
        lib.dal__beta_any_sizes(stepper._handle)
    stepper.step(steps=STEPS)
    return digest(stepper.t, stepper.x, stepper.reaction)


def controlled(system: dal.System, start: Any, options: dict[str, Any]) -> str:
    options = {"progress": False, **options}
    run = dal.integrate(system, None, *start, consistent="project", **options)
    return digest(run.t, run.y, run.multipliers)


def in_lanes(system: dal.System, start: Any, scheme: str) -> str:
    q0 = start[0] + 0.01 * np.arange(5)[:, None]
    many = dal.ensemble(system, scheme, q0, np.broadcast_to(start[1], q0.shape), h=H, steps=STEPS,
                        consistent="project", lanes=True, threads=1, progress=False)  # fmt: skip
    return digest([many.lanes], many.q, many.v)


def cases() -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield the names of the states, and how each is computed."""
    for name in [*TWINS, *dal.systems.names_in_sympy()]:
        in_c, model = pair_of(name) if name in TWINS else [getattr(dal.systems, name)()] * 2
        start = in_c.q0, in_c.v0
        compilations = {"model": model} if in_c is model else {"C": in_c, "model": model}
        for label, system in compilations.items():
            for scheme in SCHEMES:
                for sizes in ("fixed", "any") if scheme != "reference" else ("fixed",):
                    yield (f"{name} {label} {scheme} {sizes}",
                           lambda s=system, r=scheme, a=sizes: stepped(s, start, r, a == "any"))
            for control, options in CONTROLS.items():
                yield (f"{name} {label} {control}",
                       lambda s=system, o=options: controlled(s, start, o))
        for scheme in ("leapfrog", "midpoint", "endpoint", "leapfrog-kl8"):
            yield f"{name} lanes {scheme}", lambda s=model, r=scheme: in_lanes(s, start, r)


def state(compute: Callable[[], str]) -> str:
    try:
        return compute()
    except (dal.DalembertError, ValueError, NotImplementedError) as error:
        return f"{type(error).__name__}: {error}".split("\n")[0]


def main(file: Path) -> int:
    warnings.simplefilter("ignore", dal.DalembertWarning)
    states = {name: state(compute) for name, compute in cases()}
    if not file.exists():
        file.write_text(json.dumps(states, indent=1), encoding="utf-8")
        print(f"{len(states)} states, {sum(' ' in x for x in states.values())} of them errors")
        return 0
    before = json.loads(file.read_text(encoding="utf-8"))
    changed = [name for name in {**before, **states} if before.get(name) != states.get(name)]
    for name in changed:
        print(f"{name}: {before.get(name, 'not there')} -> {states.get(name, 'not there')}")
    print(f"{len(states)} states, {len(changed)} changed")
    return bool(changed)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
