"""Damage the planar robot's file anywhere: `load` ends in a model that works, or in one line."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError
from ffsms_pin.urdf import model_path

PLANAR = model_path("planar_3r").read_text()
VALUES = ["0", "-1", "nan", "inf", "1e400", "1e-400", "1e-320", "1e300", "pi/2", "1 2 3", "0 0 0", "", " "]
VALUES += [
    "base",
    "link_2",
    "joint_2",
    "fixed",
    "floating",
    "continuous",
    "prismatic",
    "a\nb",
    "\u0663",
    "\u00e9",
]
TAGS = ["robot", "link", "joint", "inertial", "mass", "inertia", "origin", "axis", "limit", "parent", "child"]
TAGS += [
    "mimic",
    "dynamics",
    "safety_controller",
    "calibration",
    "material",
    "visual",
    "collision",
    "box",
    "mesh",
]


def damaged(draw: Any) -> str:
    root = ElementTree.fromstring(PLANAR)
    for _ in range(draw(st.integers(1, 3))):
        parents = {child: parent for parent in root.iter() for child in parent}
        element = draw(st.sampled_from(list(root.iter())))
        parent = parents.get(element)
        action = draw(st.sampled_from(["drop attribute", "set", "add", "drop", "double", "rename", "move"]))
        if action in ("drop attribute", "set") and element.attrib:
            key = draw(st.sampled_from(sorted(element.attrib)))
            del element.attrib[key]
            if action == "set":
                element.set(key, draw(st.sampled_from(VALUES)))
        elif action == "add":
            ElementTree.SubElement(element, draw(st.sampled_from(TAGS)), name=draw(st.sampled_from(VALUES)))
        elif action == "rename":
            element.tag = draw(st.sampled_from(TAGS))
        elif parent is not None and action == "drop":
            parent.remove(element)
        elif parent is not None and action == "double":
            parent.append(element)
        elif parent is not None and action == "move":
            parent.remove(element)
            draw(st.sampled_from(list(root.iter()))).append(element)
    text = ElementTree.tostring(root, encoding="unicode")
    if draw(st.integers(0, 4)) == 0:
        start = draw(st.integers(0, len(text) - 1))
        text = text[:start] + draw(st.sampled_from(["", "<", "&", '"', "\0", "</robot>"])) + text[start + 3 :]
    return text


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files_end_in_a_model_or_in_one_line(data: st.DataObject) -> None:
    text = damaged(data.draw)
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as spoken:
        path = Path(folder) / "damaged.urdf"
        path.write_text(text, encoding="utf-8")
        line, kept = "", os.dup(2)
        os.dup2(spoken.fileno(), 2)
        try:
            sms = ffsms.load(path)
            state = sms.at(sms.configuration(np.full(sms.n, 0.1)), np.ones(sms.nv))
            assert np.isfinite(state.H_q).all()
            assert np.isfinite(state.C_q).all()
        except FfsmsError as error:
            line = str(error)
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        assert "\n" not in line
        assert "Pinocchio" not in line  # our own checks name the fault before its parser does
        spoken.seek(0)
        assert spoken.read() == b""  # and so its parser has nothing to print
