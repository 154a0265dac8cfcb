"""What is loaded, and when: nothing that plots, shows or solves before it is used."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest
from scipy.linalg import lapack as whole

from ffsms_pin import lapack

SLOW = (
    "IPython",
    "cloudpickle",
    "dask",
    "distributed",
    "example_robot_data",
    "matplotlib",
    "meshcat",
    "proxsuite",
    "rich",
    "scipy",
    "zmq",
)

# Packages whose names are imported when they are first asked for.
LATER = ["campaigns", "client", "contact", "control", "engine", "opt", "plotting", "scenarios"]
LATER += ["simulation"]


def loaded_by(code: str) -> set[str]:
    """Modules that a fresh Python loads for the code, those of numpy and Pinocchio left out."""
    shown = (
        f"import sys, numpy, pinocchio\nbefore = set(sys.modules)\n{code}\nprint(*set(sys.modules) - before)"
    )
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return set(done.stdout.split())


def packages(modules: set[str]) -> set[str]:
    """The packages that modules belong to, Python's own left out."""
    return {name.split(".")[0] for name in modules} - set(sys.stdlib_module_names) - {"__mp_main__"}


def test_the_library_loads_nothing_but_itself() -> None:
    loaded = loaded_by("import ffsms_pin")
    assert packages(loaded) - {"numpy"} == {"ffsms_pin"}
    for part in ("opt", "control", "simulation", "scenarios", "plotting", "viewer", "cli"):
        assert f"ffsms_pin.{part}" not in loaded


def test_the_viewer_takes_meshcat_s_page_and_imports_nothing_of_it() -> None:
    code = "import ffsms_pin as f; s = f.load('planar_3r'); q = s.configuration([1.0, 1.0, 1.0])\n"
    code += "f.view(s, f.opt.plan(s, q, [0.5, 0.7, 0.0], duration=6.0, dt=0.1)).html()"
    loaded = packages(loaded_by(code))
    assert "umsgpack" in loaded
    assert not loaded & {"meshcat", "tornado", "IPython", "zmq", "pyngrok"}


def test_a_model_needs_no_more_and_a_state_only_its_linear_algebra() -> None:
    code = "import ffsms_pin as f; s = f.load('planar_3r'); q = s.configuration([0.1, 0.2, 0.3]); s.limits"
    assert not packages(loaded_by(code)) & set(SLOW)
    loaded = loaded_by(f"{code}; s.at(q).coupling.entropy")
    assert packages(loaded) & set(SLOW) == {"scipy"}
    assert not loaded & {"scipy.optimize", "scipy.interpolate", "scipy.integrate", "scipy.sparse"}


@pytest.mark.parametrize("part", ["opt", "control", "simulation"])
def test_the_core_loads_no_solver_that_it_may_not_need(part: str) -> None:
    loaded = loaded_by(f"import ffsms_pin.{part}")
    allowed = {"scipy", "proxsuite"} if part != "control" else {"scipy"}
    assert packages(loaded) & set(SLOW) <= allowed
    assert not loaded & {"scipy.optimize", "scipy.interpolate", "scipy.integrate"}


@pytest.mark.parametrize("part", LATER)
def test_names_that_are_imported_later_are_all_shown_and_none_is_a_module(part: str) -> None:
    package = importlib.import_module(f"ffsms_pin.{part}")
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
    assert set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert not isinstance(getattr(package, name), ModuleType), name
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018 - the access is the test


def test_routines_of_lapack_are_scipy_s_own() -> None:
    assert lapack.dposv is whole.dposv
    assert "dposv" in vars(lapack)  # kept: the next call finds it without asking
    with pytest.raises(AttributeError, match="no_such_routine"):
        lapack.no_such_routine  # type: ignore[attr-defined]  # noqa: B018 - the access is the test


@pytest.mark.parametrize("name", ["Clearance", "Coupling", "Inequality", "Limit", "Residual", "Via", "check"])
def test_any_name_may_be_asked_for_first(name: str) -> None:
    assert "ffsms_pin.opt" in loaded_by(f"from ffsms_pin import opt; opt.{name}")
