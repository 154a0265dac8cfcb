"""Test that randomly damaged robot files are loaded or cause a one-line error.

The environment variable FFSMS_FUZZ sets the number of damaged files of each test (default 150).
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidUrdf
from ffsms_pin.inspection import inspect, repair
from ffsms_pin.urdf import model_names, model_path

# `load` may warn of defaults that it assumes for a damaged file.
pytestmark = pytest.mark.filterwarnings("ignore::ffsms_pin.errors.FfsmsWarning")

EXAMPLES = int(os.environ.get("FFSMS_FUZZ", "150"))
FUZZ = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
FILES = [model_path(name).read_text() for name in model_names()]
# The shortest file is drawn more often, because most faults can occur in it.
FILES += [FILES[model_names().index("planar_3r")]] * 3
TOOLS = [None, "end_effector", "left_tool"]
NUMBERS = ["0", "-1", "nan", "inf", "-inf", "1e400", "1e-400", "1e-320", "1e300", "1e31", "-0.0", "1e-160"]
VALUES = [
    *NUMBERS,
    "pi/2",
    "1 2 3",
    "0 0 0",
    "1e200 1e200 1e200",
    "0.010 ",
    "",
    " ",
    "\u0663",
    "\u00e9",
    "a\nb",
]
VALUES += ["base", "link_2", "joint_2", "link_1", "joint_1", "fixed", "floating", "continuous", "prismatic"]
VALUES += ["planar", "package://a/b.stl", "universe", "root_joint"]
TAGS = ["robot", "link", "joint", "inertial", "mass", "inertia", "origin", "axis", "limit", "parent", "child"]
TAGS += ["mimic", "dynamics", "safety_controller", "calibration", "material", "visual", "collision", "box"]
TAGS += ["mesh", "geometry", "sphere", "gazebo", "transmission"]
TOKENS = [
    "<",
    ">",
    "/>",
    "</",
    "&",
    "&amp;",
    '"',
    "'",
    "=",
    "<!--",
    "-->",
    "<![CDATA[",
    "]]>",
    "\0",
    "</robot>",
]
TOKENS += ["<?xml?>", "<link/>", "<joint/>", "<!DOCTYPE a>", "\ufeff", "&#0;", "&x;", *NUMBERS, *VALUES]


def restructured(draw: Any) -> str:
    """Drop, double, rename, move or change elements and attributes of a random file."""
    root = ElementTree.fromstring(draw(st.sampled_from(FILES)))
    for _ in range(draw(st.integers(1, 3))):
        parents = {child: parent for parent in root.iter() for child in parent}
        element = draw(st.sampled_from(list(root.iter())))
        parent = parents.get(element)
        action = draw(
            st.sampled_from(["drop attribute", "set", "add", "drop", "double", "rename", "move", "exchange"])
        )
        if action in ("drop attribute", "set") and element.attrib:
            key = draw(st.sampled_from(sorted(element.attrib)))
            del element.attrib[key]
            if action == "set":
                element.set(key, draw(st.sampled_from(VALUES)))
        elif action == "add":
            ElementTree.SubElement(element, draw(st.sampled_from(TAGS)), name=draw(st.sampled_from(VALUES)))
        elif action == "rename":
            element.tag = draw(st.sampled_from(TAGS))
        elif action == "exchange":
            other = draw(st.sampled_from(list(root.iter())))
            element.attrib, other.attrib = other.attrib, element.attrib
        elif parent is not None and action == "drop":
            parent.remove(element)
        elif parent is not None and action == "double":
            parent.append(element)
        elif parent is not None and action == "move":
            parent.remove(element)
            draw(st.sampled_from(list(root.iter()))).append(element)
    return ElementTree.tostring(root, encoding="unicode")


def respelled(draw: Any) -> str:
    """Drop, double, exchange or replace words, numbers and characters of a random file."""
    tokens = re.findall(r"\s+|[\w.+-]+|[^\w\s]", draw(st.sampled_from(FILES)))
    places = st.integers(0, len(tokens) - 1)
    for _ in range(draw(st.integers(1, 4))):
        i, j = draw(places), draw(places)
        action = draw(st.sampled_from(["drop", "double", "exchange", "replace", "replace number", "cut"]))
        if action == "drop":
            tokens[i] = ""
        elif action == "double":
            tokens[i] += tokens[i]
        elif action == "exchange":
            tokens[i], tokens[j] = tokens[j], tokens[i]
        elif action == "replace":
            tokens[i] = draw(st.sampled_from(TOKENS))
        elif action == "replace number":
            numbers = [k for k, token in enumerate(tokens) if token[:1].isdigit()]
            tokens[draw(st.sampled_from(numbers)) if numbers else i] = draw(st.sampled_from(VALUES))
        elif draw(st.booleans()):  # rarely, because a truncated file hides all other damage
            tokens[max(i, 1) :] = [""] * (len(tokens) - max(i, 1))
    return "".join(tokens)


def check_quietly(work: Callable[[Path], None], text: str, folder: Path) -> None:
    """Call `work` with a file of the text; check that it prints nothing and raises at most one line."""
    path = folder / "damaged.urdf"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    line, stderr = "", os.dup(2)
    with tempfile.TemporaryFile() as printed:
        os.dup2(printed.fileno(), 2)
        try:
            work(path)
        except FfsmsError as error:
            line = str(error)
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        assert "\n" not in line
        assert "Pinocchio" not in line  # the library's checks find the fault before the parser does
        printed.seek(0)
        assert printed.read() == b""  # the parser prints nothing


def evaluate(sms: ffsms.SpaceManipulator) -> None:
    state = sms.at(sms.configuration(np.full(sms.n, 0.1)), np.ones(sms.nv))
    for name in ("H_q", "C_q", "C_bm", "J_star"):
        assert np.isfinite(getattr(state, name)).all(), name


@pytest.mark.parametrize("damaged", [restructured, respelled])
def test_damaged_files_are_loaded_or_refused(damaged: Callable[[Any], str], tmp_path: Path) -> None:
    @FUZZ
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        text, tool = damaged(data.draw), data.draw(st.sampled_from(TOOLS))
        check_quietly(lambda path: evaluate(ffsms.load(path, end_effector=tool)), text, tmp_path)

    check()


@pytest.mark.parametrize("damaged", [restructured, respelled])
def test_damaged_shapes_are_all_loaded_or_refused(damaged: Callable[[Any], str], tmp_path: Path) -> None:
    def shapes(path: Path) -> None:
        sms = ffsms.load(path, end_effector=None)
        for kind in ("visual", "collision"):
            expected = len(ElementTree.parse(path).getroot().findall(f"link/{kind}"))
            assert sms.geometry("visual" if kind == "visual" else "collision").ngeoms == expected

    @settings(FUZZ, max_examples=EXAMPLES // 3)
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        check_quietly(shapes, damaged(data.draw), tmp_path)

    check()


@pytest.mark.parametrize("damaged", [restructured, respelled])
def test_damaged_arms_are_mounted_or_refused(damaged: Callable[[Any], str], tmp_path: Path) -> None:
    @settings(FUZZ, max_examples=EXAMPLES // 3)
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        text, tool = damaged(data.draw), data.draw(st.sampled_from(TOOLS))
        locked = data.draw(st.sampled_from([{}, {"joint_2": 0.3}, {"elbow_pitch": -0.1}]))
        check_quietly(
            lambda path: evaluate(ffsms.mount(path, end_effector=tool, locked=locked)), text, tmp_path
        )

    check()


@pytest.mark.parametrize("damaged", [restructured, respelled])
def test_damaged_files_are_repaired_or_refused(damaged: Callable[[Any], str], tmp_path: Path) -> None:
    out = tmp_path / "mended.urdf"

    def mend(path: Path) -> None:
        report = inspect(path)
        out.unlink(missing_ok=True)
        try:
            changes = repair(path, out)
        except InvalidUrdf:
            assert not report.repairable
            assert not out.exists()
            raise
        assert report.repairable
        assert report.loads or changes  # no repair is silent
        assert inspect(out).loads

    @settings(FUZZ, max_examples=EXAMPLES // 3)
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        check_quietly(mend, damaged(data.draw), tmp_path)

    check()
