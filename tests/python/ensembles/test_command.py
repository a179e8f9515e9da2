"""`dalembert ensemble`, and the pictures and pages of ensembles."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray

import dalembert as dal
from dalembert.cli import main

RUN = ["ensemble", "sleigh", "--h", "0.01", "--t-end", "0.5"]


def test_grid_and_files(tmp_path, capsys):
    grid = ["--grid", "a=0.1:0.3:3", "--grid", "v_theta=1,2", "--consistent", "project"]
    for name in ("o.npz", "o.nc"):
        assert main([*RUN, *grid, "--output", str(tmp_path / name)]) == 0
    assert "6 runs (3 x 2)" in capsys.readouterr().out
    found = np.load(tmp_path / "o.npz")
    system = dal.systems.sleigh(a=0.2)
    v0 = np.append(system.v0[:2], 2.0)
    v0[:2] = dal.systems.sleigh().v0[:2]
    run = dal.integrate(system, q0=system.q0, v0=v0, consistent="project", h=0.01, t_end=0.5)
    assert (found["q"][3] == run.q[-1]).all() and found["parameter_a"][3] == 0.2
    with xarray.open_dataset(tmp_path / "o.nc") as dataset:
        assert dataset.q.dims == ("a", "v_theta", "coordinate")
        assert (dataset.q.values.reshape(6, 3) == found["q"]).all()


def test_store_processes_and_names(tmp_path, capsys):
    store = ["--store", str(tmp_path / "store"), "--keep", "theta,energy", "--stride", "10"]
    for executor in (["--executor", "processes:2"], ["--threads", "1"]):
        assert main([*RUN, "--grid", "a=0.1,0.2", *store, *executor]) == 0
    assert dal.open_ensemble(tmp_path / "store").theta.shape == (2, 6)


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("a=0:1", ["--grid", "a=0:1"]),
        ("give at least one", []),
        ("'b'", ["--grid", "b=1,2"]),
        ("more than once", ["--grid", "a=1,2", "--grid", "a=3"]),
        ("expected one of them", ["--grid", "a=1,2", "--parameter", "a=3"]),
        (".nc or .npz", ["--grid", "a=1,2", "--output", "o.txt"]),
        ("dask://HOST:PORT", ["--grid", "a=1,2", "--executor", "cloud"]),
        ("keep", ["--grid", "a=1,2", "--keep", "everything"]),
    ],
)
def test_wrong_arguments(words, given, capsys):
    assert main([*RUN, *given]) == 2
    assert words in capsys.readouterr().err


def test_all_fail(capsys):
    assert main([*RUN, "--grid", "J=-1,-2"]) == 1
    assert "2 of 2 members failed" in capsys.readouterr().err


@pytest.mark.parametrize("who", [["--executor", "processes:2"], ["--threads", "2"]])
def test_ctrl_c(who, tmp_path):
    command = [sys.executable, "-m", "dalembert", "ensemble", "sleigh", "--grid", "a=0.1:0.3:8",
               "--h", "0.0001", "--steps", "2000000000", "--store", str(tmp_path / "store"),
               *who]  # fmt: skip
    process = subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    try:
        while not (tmp_path / "store").exists():
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130
        assert b"repeat the same command" in process.stderr.read()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def many(**more):
    return dal.ensemble(dal.systems.sleigh(), **{"h": 0.01, "steps": 40, "progress": False} | more)


def test_pictures():
    values = {"a": np.linspace(0.1, 0.3, 8)}
    bands = many(parameters=values, keep="all", stride=10).plot("theta")
    assert bands.get_xlabel() == "t" and len(bands.collections) == 2
    line = bands.lines[0].get_ydata()
    theta = many(parameters=values, keep="theta", stride=10).theta
    np.testing.assert_allclose(line, np.median(theta, axis=0))
    ends = many(parameters=values).plot("x", y="v_theta")
    assert ends.get_ylabel().startswith("v_theta")
    grid = dal.grid(a=[0.1, 0.2, 0.3], J=[1, 2])
    wall = dal.Event(lambda t, q, v: q[0] - 0.05, terminal=True)
    walls = many(parameters=grid, events=[wall]).plot()
    assert walls.get_xlabel() == "a" and walls.get_ylabel() == "J"
    assert many(parameters=grid).plot("theta").collections
    assert many(parameters=values, keep=["end", "energy"]).plot().get_xlabel().startswith("energy")
    for wrong in ("colour", "q"):
        with pytest.raises(ValueError, match="what"):
            many(parameters=values).plot(wrong)


def test_page():
    with pytest.warns(dal.DalembertWarning):
        found = many(parameters={"J": [1.0, -1.0]})
    page = found._repr_html_()
    assert "sleigh by leapfrog" in page and "parameter J of sleigh = -1" in page
