"""Write and run scenario files with simulation conditions, for tests."""

from __future__ import annotations

from pathlib import Path

from scenario_files import IN_DEGREES, write

from ffsms_pin.scenarios import Outcome, run, scenario

__all__ = ["CONDITIONS", "QUICK", "run_text", "text"]

QUICK = f"""{IN_DEGREES}\
[plan]
duration = 2.0
dt = 0.05
method = "resolved-rate"
[control]
law = "computed-torque"
dt = 0.01
"""

# All tables of the closed loop, with a value other than the default for each key.
CONDITIONS = {
    "simulation": 'integrator = "variational"\nmomentum = [0.01, -0.02, 0, 0, 0, 0.003]\n',
    "plant": "arm_mass = [1.2, 1.1, 0.9]\narm_inertia = 1.3\narm_com = [0.01, 0.0, 0.0]\n"
    "base_mass = 0.9\nbase_inertia = 0.95\nbase_com = [0.0, 0.01, 0.0]\n",
    "friction": "viscous = 0.02\ncoulomb = [0.001, 0.002, 0.003]\ntransition_deg = 2.0\n",
    "actuator": "torque_limit = 0.05\nrate_limit = [2.0, 3.0, inf]\ndelay = 0.03\n",
    "sensors": "joint_resolution_deg = 0.1\njoint_noise = 1e-4\njoint_rate_noise = 1e-3\n"
    "base_position_noise = 1e-3\nbase_attitude_noise_deg = 0.05\nbase_velocity_noise = 1e-3\n"
    "base_rate_noise = 1e-3\nbase_latency = 0.05\nseed = 7\n",
    "disturbance": 'wrench = [0, 0, 0, 0, 0, 0.01]\non = "base"\nstart = 0.5\nend = 1.0\n',
    "capture": "time = 1.0\nmass = 0.5\ninertia = [0.01, 0.01, 0.01]\ncom = [0.05, 0, 0]\n"
    "twist = [0.01, 0, 0, 0, 0, 0.02]\n",
    "fault": 'time = 1.5\njoint = "joint_2"\nkind = "limp"\nreported = false\n',
}


def text(*names: str) -> str:
    """Return QUICK with some of the conditions."""
    several = ("disturbance", "capture", "fault")
    return QUICK + "".join(
        (f"[[{name}]]\n" if name in several else f"[{name}]\n") + CONDITIONS[name] for name in names
    )


def run_text(folder: Path, content: str) -> Outcome:
    """Return the outcome of a scenario file with this content."""
    return run(scenario(write(folder, content)))
