"""Runs in files and in other packages."""

import csv
import os

import numpy as np
import pytest

import dalembert as dal
from test_journal import CASES, assert_same, given_system


@pytest.fixture
def run(request):
    make, scheme, options, functions = CASES[request.param]
    return dal.integrate(make(), scheme, **{"h": 0.05, "steps": 60, **options}, **functions)


IN_NETCDF = {"table", "controller and events", "output times and inputs", "error-controlled"}


@pytest.mark.parametrize(
    ("run", "suffix"),
    [*((name, ".npz") for name in CASES), *((name, ".nc") for name in CASES if name in IN_NETCDF)],
    indirect=["run"],
)
def test_what_is_saved_is_loaded(run, tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    run.save(path)
    found = dal.load(path, given_system(run.system))
    assert_same(found, run)
    assert found.stats == run.stats and found.message == run.message
    assert found.scheme.name == run.scheme.name and found.t0 == run.t0
    for name in ("energy", "multipliers", "residual"):
        np.testing.assert_array_equal(getattr(found, name), getattr(run, name))
    if found.times is None:
        np.testing.assert_array_equal(found(0.7).q, run(0.7).q)
    assert sorted(os.listdir(tmp_path)) == [path.name]


def test_without_constraints(tmp_path):
    """Arrays without entries are there too."""
    system = dal.System(mass=[1.0], potential=lambda q: q[0] ** 2 / 2, q0=[1], v0=[0])
    run = dal.integrate(system, h=0.1, steps=5)
    for suffix in (".npz", ".nc", ".csv"):
        path = tmp_path / f"run{suffix}"
        run.save(path)
        if suffix != ".csv":
            assert_same(dal.load(path, system), run)
    single = dal.integrate(system, h=0.1, steps=0)
    single.save(tmp_path / "single.nc")
    assert_same(dal.load(tmp_path / "single.nc", system), single)


def test_csv(tmp_path):
    run = dal.integrate(dal.systems.sleigh(), h=0.1, steps=5)
    path = tmp_path / "run.csv"
    run.save(path)
    with open(path, newline="") as file:
        head, *rows = csv.reader(file)
    assert head == [
        "t", "x", "y", "theta", "v_x", "v_y", "v_theta", "lambda_0", "energy", "residual"
    ]  # fmt: skip
    values = np.array(rows, dtype=float)
    np.testing.assert_array_equal(values[:, 0], run.t)  # 17 digits are the doubles
    np.testing.assert_array_equal(values[:, 1:7], run.x)
    np.testing.assert_array_equal(values[:, 7], run.multipliers[:, 0])


def test_csv_of_odd_names(tmp_path):
    names = ["p,q", 'r"s', "t"]
    run = dal.integrate(
        dal.System(mass=[1, 1, 1], coordinates=names), q0=[0, 0, 0], v0=[1, 2, 3], h=1, steps=1
    )
    run.save(tmp_path / "run.csv")
    with open(tmp_path / "run.csv", newline="") as file:
        head, *rows = csv.reader(file)
    assert head[1:4] == names and len(rows[0]) == len(head) == 9


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (["energy", "residual"], "energy residual v_energy v_residual energy_ residual_"),
        (["x", "v_x"], "x v_x v_x_ v_v_x energy residual"),
        (["t", "v_t_"], "t v_t_ v_t v_v_t_ energy residual"),
        (["v_x", "x"], "v_x x v_v_x v_x_ energy residual"),
    ],
)
def test_columns_have_different_names(names, columns, tmp_path):
    """A coordinate has its name, and what else would be called so a "_" behind it."""
    units = {"x": "m", "v_x": "m"} if "v_x" in names else None
    system = dal.System(mass=[1, 1], coordinates=names, units=units, q0=[1, 2], v0=[3, 4])
    run = dal.integrate(system, "explicit", h=0.5, steps=2)
    frame = run.to_pandas()
    assert list(frame.columns) == columns.split()
    assert frame.index.name == ("t_" if "t" in names else "t")
    np.testing.assert_array_equal(frame[names], run.q)
    np.testing.assert_array_equal(frame.iloc[:, 2:4], run.v)
    np.testing.assert_array_equal(frame.iloc[:, 4], run.energy)
    assert len(frame.reset_index().columns) == 7
    assert frame.attrs["units"] == (units or {})
    run.save(tmp_path / "run.csv")
    head = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert head == ",".join([frame.index.name, *frame.columns])


def test_pandas():
    run = dal.integrate(dal.systems.sleigh(), h=0.1, steps=5)
    frame = run.to_pandas()
    np.testing.assert_array_equal(frame.index, run.t)
    np.testing.assert_array_equal(frame[["x", "y", "theta"]], run.q)
    np.testing.assert_array_equal(frame["energy"], run.energy)


def test_xarray_units():
    make, scheme, options, functions = CASES["table"]
    run = dal.integrate(make(), scheme, h=0.05, steps=60, **options, **functions)
    data = run.to_xarray(units={"t": "s", "x": "m", "theta": "rad"})
    assert data.time.attrs["units"] == "s"
    assert data.unit.sel(coordinate="theta").item() == "rad"
    assert data.unit.sel(coordinate="y").item() == ""
    assert "coordinates" in data.q.attrs["long_name"]
    np.testing.assert_array_equal(data.inputs.sel(input="turn"), run.inputs[:, 1])
    np.testing.assert_array_equal(data.q.sel(coordinate="y"), run.q[:, 1])
    np.testing.assert_array_equal(data.multipliers, run.multipliers)
    np.testing.assert_array_equal(data.interval, (run.t[1:] + run.t[:-1]) / 2)
    assert data.attrs["scheme"] == scheme and data.attrs["h"] == 0.05
    with pytest.raises(ValueError, match="units: 'z' is unknown; expected some of x, y, theta"):
        run.to_xarray(units={"z": "m"})


def test_units_of_the_system(tmp_path):
    units = {"x": "m", "y": "m", "theta": "rad", "t": "s", "energy": "J"}
    run = dal.integrate(dal.systems.sleigh().with_units(**units), h=0.1, steps=5)
    run.save(tmp_path / "run.nc")
    assert dal.load(tmp_path / "run.nc").system.units == units
    data = run.to_xarray()
    assert data.time.attrs["units"] == "s" and data.energy.attrs["units"] == "J"
    assert data.unit.values.tolist() == ["m", "m", "rad"]
    other = run.to_xarray(units={"x": "mm"})
    assert other.unit.values.tolist() == ["mm", "m", "rad"] and other.time.attrs["units"] == "s"
    bare = dal.integrate(dal.systems.sleigh(), h=0.05, steps=10).to_xarray()
    assert "units" not in bare.energy.attrs and bare.time.attrs["units"] == ""


def test_numpy_writes_a_run(tmp_path):
    """np.savez takes a run as a mapping, and np.load needs no pickles for it."""
    run = dal.integrate(dal.systems.sleigh(), h=0.1, steps=5)
    np.savez(tmp_path / "run.npz", **run)
    with np.load(tmp_path / "run.npz", allow_pickle=False) as found:
        assert sorted(found.files) == sorted(run)
        for name in found.files:
            np.testing.assert_array_equal(found[name], run[name])


def test_refused(tmp_path):
    run = dal.integrate(dal.systems.sleigh(), h=0.1, steps=5)
    for name in ("run.txt", "run"):
        with pytest.raises(ValueError, match="expected a name that ends in .npz, .nc or .csv"):
            run.save(tmp_path / name)
    with pytest.raises(OSError, match="there is no folder"):
        run.save(tmp_path / "none" / "run.npz")
    assert os.listdir(tmp_path) == []
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    (tmp_path / "empty.npz").write_bytes(b"")
    run.save(tmp_path / "run.npz")
    whole = (tmp_path / "run.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("other.npz", "empty.npz", "half.npz"):
        with pytest.raises(ValueError, match=f"{name}: expected the journal of a run"):
            dal.load(tmp_path / name)
    run.save(tmp_path / "run.nc")
    whole = (tmp_path / "run.nc").read_bytes()
    (tmp_path / "half.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises((ValueError, OSError)):
        dal.load(tmp_path / "half.nc")
    with pytest.raises(ValueError, match="belongs to another system"):
        dal.load(tmp_path / "run.npz", dal.systems.particle())


def test_flipped_bytes_are_no_wrong_states(tmp_path):
    """The archive has checksums of its own: a run that loads is the one that was saved."""
    run = dal.integrate(dal.systems.sleigh(), h=0.1, steps=2)
    path = tmp_path / "run.npz"
    run.save(path)
    content = path.read_bytes()
    loaded = 0
    for k in range(0, len(content), 83):
        path.write_bytes(content[:k] + bytes([content[k] ^ 16]) + content[k + 1 :])
        try:
            found = dal.load(path)
        except (ValueError, OSError, NotImplementedError, EOFError):
            continue
        loaded += 1
        np.testing.assert_array_equal(found.x, run.x)
        np.testing.assert_array_equal(found.reactions, run.reactions)
    assert loaded < len(content) / 83
