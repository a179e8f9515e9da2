"""Write test vectors as C tables, for the C test that declares their types.

usage: python make_vectors_header.py vectors.json reference.json output.h TABLE...

A number is written with all the digits that it has; the C compiler rounds it, once and correctly.
What an entry does not have is left out, and so NULL.
"""

import json
import sys
from pathlib import Path

SCHEMES = {"strang01": "leapfrog", "strang10": "leapfrog-mirror"}
INITIAL = {"D": "DAL_INITIAL_D", "D_eps": "DAL_INITIAL_D_EPS"}


def number(text):
    """Return a decimal or a fraction as a C double."""
    parts = [part if set(part) & set(".e") else part + ".0" for part in text.split("/")]
    return " / ".join(parts)


def flat(values):
    """Return the entries of nested lists."""
    return [x for value in values for x in flat(value)] if isinstance(values, list) else [values]


def array(*values):
    """Return the entries of vectors and matrices, one after the other, as a C initializer."""
    return "{" + ", ".join(number(x) for x in flat(list(values))) + "}"


def pointer(value):
    """Return a C array that a pointer can point to; NULL for None."""
    return "NULL" if value is None else "(const double[])" + array(value)


def quoted(text):
    return "NULL" if text is None else f'"{text}"'


def record(**fields):
    """Return a C struct."""
    return "{" + ",\n     ".join(f".{name} = {value}" for name, value in fields.items()) + "}"


def run(group, entry):
    """Return an entry that is a number of steps of a scheme: a run_vector."""
    scheme = entry.get("scheme", "beta")
    base = "midpoint-" if entry.get("base") == "beta=1/2" else ""
    return record(
        group=quoted(group),
        system=quoted(entry["system"]),
        scheme=quoted(None if scheme == "beta" else SCHEMES.get(scheme, base + scheme)),
        beta=number(entry.get("beta", "0")),
        initial=INITIAL[entry["data"]] if group == "hat" else "DAL_INITIAL_NONE",
        h=number(entry["eps"]),
        steps=entry.get("steps", 1),
        x=array(entry["q"], entry["v"]),
        x1=array(entry["q1"], entry["v1"]),
        reaction=pointer(entry.get("lambda", entry.get("lambda_mean"))),
        multipliers=pointer(entry.get("lambda_consistent")),
        energy=pointer(entry.get("energy1")),
    )


def point(entry):
    """Return an entry of the continuous problem: a point_vector."""
    off = entry["off_D"]
    return record(
        system=quoted(entry["system"]),
        x=array(entry["q"], entry["v"]),
        energy=number(entry["energy"]),
        f_v=array(entry["f_v"]),
        vdot=array(entry["vdot"]),
        multipliers=array(entry["lambda"]),
        C=array(entry["C"]),
        mass=array(entry["mass"]),
        mu=array(entry["mu"]),
        gamma=array(entry["gamma"]),
        off_x=array(entry["q"], off["v"]),
        off_multipliers=array(off["lambda"]),
        off_vdot=array(off["vdot"]),
        projected_v=array(off["projected_v"]),
    )


def equations(entry):
    """Return the equations of a step at a point where they do not hold: an equations_vector."""
    return record(
        system=quoted(entry["system"]),
        beta=number(entry["beta"]),
        h=number(entry["eps"]),
        x=array(entry["q"], entry["v"]),
        **{name: array(entry[name]) for name in ("w", "kappa", "R1", "R2", "K", "B", "mu_k")},
    )


def projection(entry):
    """Return a projection onto D_eps: a projection_vector."""
    return record(
        system=quoted(entry["system"]),
        beta=number(entry["beta"]),
        h=number(entry["eps"]),
        x=array(entry["q"], entry["v"]),
        v1=array(entry["v1"]),
    )


def chart(entry):
    """Return the Ehresmann connection in a choice of dependent coordinates: a chart_vector."""
    return record(
        system=quoted(entry["system"]),
        dependent="{" + ", ".join(map(str, entry["dependent"])) + "}",
        xi=array(entry["q"], entry["v_ind"]),
        **{name: array(entry[name]) for name in ("A", "B", "v_dep")},
        multipliers=array(entry["lambda"]),
        multipliers_E=array(entry["lambda_E"]),
    )


def node(entry):
    """Return a step of the node map: a node_vector."""
    return record(
        system=quoted(entry["system"]),
        beta=number(entry["beta"]),
        h=number(entry["eps"]),
        before=array(entry["q_prev"]),
        q=array(entry["q_k"]),
        after=array(entry["q_next"]),
        multipliers=array(entry["lambda"]),
    )


def reference(name, entry, t):
    """Return an end state of the flow: a reference_vector."""
    start, end = entry["initial"], entry["states"][t]
    return record(
        system=quoted(name),
        t=number(t),
        x0=array(start["q"], start["v"]),
        x=array(end["q"], end["v"]),
        multipliers=array(end["lambda"]),
        energy=number(end["energy"]),
    )


def embedding(entry):
    """Return a point of the field of an embedding: an embedding_vector."""
    return record(
        beta=number(entry["beta"]),
        order=entry["p"],
        h=number(entry["eps"]),
        slope=number(entry["dchi0"]),
        G=array(entry["G_of_z"]),
        **{name: number(entry[name]) for name in ("tau", "chi0", "chi1")},
        **{name: array(entry[name]) for name in ("z", "y", "g")},
    )


def main(vectors_path, reference_path, output, *wanted):
    vectors = json.loads(Path(vectors_path).read_text(encoding="ascii"))
    references = json.loads(Path(reference_path).read_text(encoding="ascii"))
    groups = ("onestep", "multistep", "hat", "composition", "unconstrained")
    tables = {
        "run": [run(group, entry) for group in groups for entry in vectors[group]],
        "point": [point(entry) for entry in vectors["continuous"]],
        "equations": [equations(entry) for entry in vectors["newton"]],
        "embedding": [embedding(entry) for entry in vectors["embedding"]],
        "chart": [chart(entry) for entry in vectors["ehresmann"]],
        "projection": [projection(entry) for entry in vectors["projection"]],
        "node": [node(entry) for entry in vectors["node"]],
        "reference": [
            reference(name, references[name], t) for name in vectors["systems"] for t in ("1", "10")
        ],
    }
    text = "/* Generated by make_vectors_header.py. */\n"
    for name in wanted:
        rows = tables[name]
        body = ",\n    ".join(rows)
        text += f"\nstatic const {name}_vector {name}_vectors[] = {{\n    {body},\n}};\n"
    Path(output).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(*sys.argv[1:])
