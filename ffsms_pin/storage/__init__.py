"""Files of results: written whole or not at all, read with errors that say what is wrong."""

from ffsms_pin.storage.archives import load_arrays, save_arrays
from ffsms_pin.storage.paths import path_like
from ffsms_pin.storage.shapes import check_shapes, check_times, numbers_by_name
from ffsms_pin.storage.temporary import remove_leftovers
from ffsms_pin.storage.writing import (
    check_writable,
    regular_target,
    replace_file,
    require_space,
    write_atomically,
    write_content,
)

__all__ = [
    "check_shapes",
    "check_times",
    "check_writable",
    "load_arrays",
    "numbers_by_name",
    "path_like",
    "regular_target",
    "remove_leftovers",
    "replace_file",
    "require_space",
    "save_arrays",
    "write_atomically",
    "write_content",
]
