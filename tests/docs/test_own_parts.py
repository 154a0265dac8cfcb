"""Run the code of docs/own-parts.md, and test its terms and limits and their derivatives."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsError, InvalidScenario, InvalidValue
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.scenarios import scenario

PAGE = Path(__file__).parents[2] / "docs" / "own-parts.md"
BLOCKS = re.findall(r"^```(python|toml)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """Run the page's blocks in order in a folder with their files, and yield the defined names."""
    folder = tmp_path_factory.mktemp("own-parts")
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        for kind, text in BLOCKS:
            title = re.match(r"# (\w+\.\w+)\n", text)
            if title:
                (folder / title[1]).write_text(text, encoding="utf-8")
            if kind == "python":
                exec(compile(text, str(PAGE), "exec"), names)
        yield SimpleNamespace(**names, folder=folder)
    for name in ("gaze_term", "above_limit"):
        sys.modules.pop(name, None)


def test_every_block_is_run() -> None:
    assert [kind for kind, _ in BLOCKS].count("python") == 5
    assert [kind for kind, _ in BLOCKS].count("toml") == 1


def off_axis(page: SimpleNamespace, plan: opt.Trajectory) -> float:
    """Return the mean angle between the camera's axis and the direction of the point [rad]."""
    angles = []
    for q in plan.q[::10]:
        pose = page.sms.at(q).end_effector_pose
        direction = np.array(page.gaze.at) - pose.translation
        angles.append(
            np.arccos(np.clip(pose.rotation[:, 0] @ direction / np.linalg.norm(direction), -1.0, 1.0))
        )
    return float(np.mean(angles))


def lowest(page: SimpleNamespace, plan: opt.Trajectory) -> float:
    """Return the smallest height above the plane [m]."""
    return float((plan.end_effector @ np.array(page.above.normal)).min() - page.above.height)


def test_the_plan_keeps_the_limit_and_reduces_the_camera_angle(page: SimpleNamespace) -> None:
    assert page.plain.reached
    assert page.plan.reached
    assert lowest(page, page.plain) < -0.01
    assert lowest(page, page.plan) > -1e-6
    assert off_axis(page, page.plan) < 0.7 * off_axis(page, page.plain)
    assert page.plan.shares["gaze"] > 0.0


def test_the_note_names_a_violated_limit(page: SimpleNamespace) -> None:
    rates = page.plain.joint_rates
    motion = rolled_out(page.sms, page.problem.stack, page.q0, rates, page.plain.dt)
    broken = page.above.violation(motion)
    assert broken.amount == pytest.approx(-lowest(page, page.plain), abs=1e-5)
    assert broken.note.startswith("the limit 'above' is violated by 0.04")
    over = (page.plain.end_effector @ np.array(page.above.normal)) - page.above.height
    assert set(np.round(page.plain.t[over < 1e-3], 6)) <= set(np.round(broken.instants, 6))


def test_the_elbow_stays_below_its_limit(page: SimpleNamespace) -> None:
    def highest(plan: opt.Trajectory) -> float:
        data, frame = page.sms.model.createData(), page.sms.model.getFrameId("link_3")
        heights = []
        for q in plan.q:
            pin.framesForwardKinematics(page.sms.model, data, q)
            heights.append(float(data.oMf[frame].translation[1]))
        return max(heights)

    assert highest(page.plain) > 0.47
    assert page.low.reached
    assert highest(page.low) < 0.46


def test_parts_of_the_page_are_as_short_as_stated() -> None:
    """The residual has at most two lines, the slack one line, and the limit on the elbow five lines."""
    text = "".join(text for _, text in BLOCKS)
    elbow = text[text.index("class Elbow") :].split("# camera")[0].split("import numpy")[0].splitlines()
    assert len([line for line in elbow if line.strip()]) <= 5
    for name, most in (("def residual(self, m):", 2), ("def slack(self, m):", 1)):
        body = text[text.index(name) :].splitlines()[1:]
        assert len(list(takewhile(lambda line: line.startswith("        "), body))) <= most


def test_a_part_without_a_name_is_refused(page: SimpleNamespace, refused: Callable[..., FfsmsError]) -> None:
    class Nameless(opt.Term):
        def residual(self, motions: opt.Rollouts) -> list[Any]:
            return []

    refused(
        lambda: opt.Problem(page.sms, page.q0, page.goal, terms=[Nameless()]), InvalidValue, "terms", "`name`"
    )


def test_the_step_planner_uses_both_parts(page: SimpleNamespace) -> None:
    assert page.step.solved
    joints = np.zeros(3)
    tip = page.sms.at(page.q0).end_effector_pose.translation
    over = float(np.array(page.above.normal) @ tip) - page.above.height
    raised = replace(page.above, height=page.above.height + over + 0.05)
    pushed = opt.StepPlanner(page.sms, limits=[*page.parts[:3], raised]).step(page.q0, joints, page.goal, 8.0)
    free = opt.StepPlanner(page.sms, limits=page.parts[:3]).step(page.q0, joints, page.goal, 8.0)
    up = np.array(page.above.normal) @ page.sms.at(page.q0).J_star[:3]
    assert up @ pushed.joint_rates > up @ free.joint_rates
    assert np.abs(page.step.joint_rates - free.joint_rates).max() > 1e-6


def test_re_planning_arrives_above_the_plane_on_a_wrong_plant(page: SimpleNamespace) -> None:
    assert page.track.position_error[-1] < 2e-3
    tips = np.array([page.heavier.at(q).end_effector_pose.translation for q in page.track.q[::50]])
    assert (tips @ np.array(page.above.normal)).min() - page.above.height > -2e-3


def test_the_scenario_file_gives_the_same_parts(page: SimpleNamespace) -> None:
    assert page.planned.reached
    assert lowest(page, page.planned) > -1e-6
    assert set(page.planned.shares) == {"coupling", "smooth", "effort", "gaze"}
    made = page.scenario.problem(page.scenario.load())
    effort = next(term for term in made.terms if term.name == "effort")
    assert effort == opt.Effort(1e-3)


def test_the_command_line_imports_only_on_request(
    page: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = page.folder / "camera.toml", page.folder / "out"
    plain = scenario(file)
    sms = plain.load()
    with pytest.raises(InvalidScenario, match="allow_import"):
        plain.problem(sms)
    assert main(["run", str(file), "--out", str(out), "--no-figures"]) == 2
    assert "--allow-import" in capsys.readouterr().err
    assert main(["run", str(file), "--out", str(out), "--no-figures", "--allow-import"]) == 0


@pytest.mark.parametrize("part", ["gaze", "above"])
def test_the_slopes_are_those_of_finite_differences(page: SimpleNamespace, part: str) -> None:
    assert opt.check(getattr(page, part), page.problem) < 1e-6
