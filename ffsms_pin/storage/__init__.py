"""Files of results: written whole or not at all, read with errors that say what is wrong."""

from ffsms_pin.storage.archives import check_shapes, check_times, load_arrays, numbers_by_name, save_arrays
from ffsms_pin.storage.files import (
    LARGEST_DATA,
    check_readable,
    check_writable,
    path_like,
    read_content,
    regular_target,
    remove_leftovers,
    replace_file,
    require_space,
    write_atomically,
    write_content,
)

__all__ = [
    "LARGEST_DATA",
    "check_readable",
    "check_shapes",
    "check_times",
    "check_writable",
    "load_arrays",
    "numbers_by_name",
    "path_like",
    "read_content",
    "regular_target",
    "remove_leftovers",
    "replace_file",
    "require_space",
    "save_arrays",
    "write_atomically",
    "write_content",
]
