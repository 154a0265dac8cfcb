"""Files of results: written whole or not at all, read with errors that say what is wrong."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.storage.archives import (
        check_shapes as check_shapes,
        check_times as check_times,
        load_arrays as load_arrays,
        numbers_by_name as numbers_by_name,
        save_arrays as save_arrays,
    )
    from ffsms_pin.storage.files import (
        LARGEST_DATA as LARGEST_DATA,
        check_readable as check_readable,
        check_writable as check_writable,
        path_like as path_like,
        read_content as read_content,
        regular_target as regular_target,
        remove_leftovers as remove_leftovers,
        replace_file as replace_file,
        require_space as require_space,
        told as told,
        write_atomically as write_atomically,
        write_content as write_content,
    )
else:
    __getattr__, __dir__, __all__ = later(__name__)
