"""What a page is sent: the latest of each command, in order."""

from __future__ import annotations

from ffsms_pin.viewer.scene import Scene


def test_a_new_page_gets_the_latest_in_order() -> None:
    log = Scene()
    log.put("set_object", "/a", "", b"object")
    log.put("set_transform", "/a", "", b"here")
    log.put("set_property", "/a", "visible", b"seen")
    log.put("set_property", "/a", "color", b"red")
    log.put("set_transform", "/a", "", b"there")
    assert log.since(0) == (5, [b"object", b"seen", b"red", b"there"])


def test_an_open_page_gets_what_is_new() -> None:
    log = Scene()
    log.put("set_object", "/a", "", b"object")
    count, _ = log.since(0)
    assert log.since(count) == (count, [])
    for k in range(10):
        log.put("set_transform", "/a", "", b"%d" % k)
    assert log.since(count) == (11, [b"9"])


def test_a_new_object_forgets_the_properties_of_the_old_one() -> None:
    log = Scene()
    for name in ("/a", "/ab"):
        log.put("set_object", name, "", b"object")
        log.put("set_property", name, "color", b"red")
    log.put("set_object", "/a", "", b"other")
    assert log.since(0)[1] == [b"object", b"red", b"other"]


def test_what_is_deleted_goes_with_all_below_it() -> None:
    log = Scene()
    for name in ("/a", "/a/b", "/ab"):
        log.put("set_object", name, "", name.encode())
    count, _ = log.since(0)
    log.put("delete", "/a", "", b"gone")
    assert log.since(0)[1] == [b"/ab", b"gone"]
    assert log.since(count)[1] == [b"gone"]
