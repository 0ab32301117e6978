"""Executes a notebook from its beginning and writes its figures: python run_notebook.py NOTEBOOK FOLDER"""

import base64
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def main(notebook: Path, folder: Path) -> None:
    book = nbformat.read(notebook, as_version=4)
    # An error in a cell ends the program with that error.
    NotebookClient(book, timeout=120, kernel_name="python3").execute(cwd=str(folder))
    pictures = [
        output["data"]["image/png"]
        for cell in book.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    for number, picture in enumerate(pictures):
        (folder / f"{notebook.stem}-{number}.png").write_bytes(base64.b64decode(picture))
    print(f"{notebook.name}: {len(book.cells)} cells, {len(pictures)} figures")
    assert pictures, "a notebook without figures shows nothing"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
