"""Makes the pictures of pages by their own code: `python docs/pictures.py docs/PAGE.md...`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

from page_code import run_page, shown  # noqa: E402
from PIL import Image  # noqa: E402

_COLOURS = 128  # of a picture: few lines and words need no more, and a third of the bytes

if __name__ == "__main__":
    for page in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as folder:
            run_page(page, Path(folder))
            for name in shown(page):
                with Image.open(Path(folder) / name) as made:
                    made.convert("RGB").quantize(_COLOURS).save(HERE / "images" / name, optimize=True)
