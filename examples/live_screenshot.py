"""A picture of the page of `gelbot live`, by a browser without a window.

python examples/live_screenshot.py live.png                                 a session made of paper
python examples/live_screenshot.py live.png http://127.0.0.1:8080/          the one that is there, 7.5 s after its start
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))


def main(to: Path, url: str | None = None, width: int = 1400, height: int = 900, wait: float = 7.5) -> Path:
    """Write the picture, `wait` seconds after the page at `url` was opened; None: a page of its own."""
    from browser import picture  # pyright: ignore[reportMissingImports]
    from gelbot.live.serve import serve
    from toy import Toy  # pyright: ignore[reportMissingImports]

    if url is not None:
        return picture(url, to, width, height, wait, start=True)
    with Toy(keep_running=True) as toy, serve(toy, port=0) as served:
        return picture(served.url, to, width, height, wait)


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None))
