"""Test that modules for plots, views and solvers are imported only when they are used."""

from __future__ import annotations

import subprocess
import sys

import ffsms_pin

SLOW = (
    "IPython",
    "dask",
    "distributed",
    "example_robot_data",
    "matplotlib",
    "meshcat",
    "pandas",
    "proxsuite",
    "rich",
    "scipy",
    "zmq",
)


def loaded_by(code: str) -> set[str]:
    """Return the modules that `code` loads in a new interpreter, except those of numpy and Pinocchio."""
    shown = (
        f"import sys, numpy, pinocchio\nbefore = set(sys.modules)\n{code}\nprint(*set(sys.modules) - before)"
    )
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return set(done.stdout.split())


def packages(modules: set[str]) -> set[str]:
    """Return the packages of modules, except the standard library."""
    return {name.split(".")[0] for name in modules} - set(sys.stdlib_module_names) - {"__mp_main__"}


def test_importing_the_library_loads_no_other_package() -> None:
    loaded = loaded_by("import ffsms_pin")
    assert packages(loaded) - {"numpy"} == {"ffsms_pin"}
    for part in ("opt", "control", "simulation", "scenarios", "plotting", "viewer", "cli"):
        assert f"ffsms_pin.{part}" not in loaded


def test_the_viewer_does_not_import_meshcat() -> None:
    code = "import ffsms_pin as f; s = f.load('planar_3r'); q = s.configuration([1.0, 1.0, 1.0])\n"
    code += "f.view(s, f.opt.plan(s, q, [0.5, 0.7, 0.0], duration=6.0, dt=0.1)).html()"
    loaded = packages(loaded_by(code))
    assert "umsgpack" in loaded
    assert not loaded & {"meshcat", "tornado", "IPython", "zmq", "pyngrok"}


def test_models_and_states_load_no_slow_module() -> None:
    code = "import ffsms_pin as f; s = f.load('planar_3r'); q = s.configuration([0.1, 0.2, 0.3]); s.limits"
    assert not packages(loaded_by(f"{code}; s.at(q).coupling.entropy")) & set(SLOW)


def test_planning_and_simulation_need_no_scipy() -> None:
    assert packages(loaded_by("import ffsms_pin.simulation")) & set(SLOW) == {"proxsuite"}
    code = "import ffsms_pin as f; s = f.load('planar_3r'); q = s.configuration([0.1, 0.2, 0.3])\n"
    code += "p = f.opt.plan(s, q, [0.7, 0.5, 0.0], duration=4.0, dt=0.1)\n"
    code += "f.simulate(s, p, f.SlidingModeController(s), dt=0.02)"
    assert packages(loaded_by(code)) & set(SLOW) == {"proxsuite"}


def test_all_public_names_exist() -> None:
    assert dir(ffsms_pin) == ffsms_pin.__all__
    for name in ffsms_pin.__all__:
        assert getattr(ffsms_pin, name) is not None
