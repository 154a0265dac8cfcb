"""Make the pictures of the documentation.

`python docs/pictures.py docs/PAGE.md...` runs the code of pages and stores the pictures that the code makes.
`python docs/pictures.py FILE.png...` copies picture files into the documentation.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

from page_code import run_page, shown  # noqa: E402
from PIL import Image  # noqa: E402

_MOST = 100_000  # largest size of a picture in bytes


def store(made: Image.Image, path: Path) -> None:
    """Write a picture to a file, with only 256 colours if the file would be too large."""
    picture = made.convert("RGB")
    picture.save(path, optimize=True)
    if path.stat().st_size > _MOST:
        # Pillow's default method, median cut, gives thin lines the colours of other lines.
        picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    for page in map(Path, sys.argv[1:]):
        if page.suffix == ".png":
            with Image.open(page) as made:
                store(made, HERE / "images" / page.name)
            continue
        with tempfile.TemporaryDirectory() as folder:
            run_page(page, Path(folder))
            for name in shown(page):
                with Image.open(Path(folder) / name) as made:
                    store(made, HERE / "images" / name)
