"""The programs of the pages run unchanged."""

import re
import subprocess
import sys
from pathlib import Path

from conftest import PATIENCE_S, PROGRAMS, PROJECT, Daemon


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (PROJECT / page).read_text(), re.DOTALL)


def works(daemon: Daemon, folder: Path, program: str) -> None:
    environment = {**daemon.environment, "MPLBACKEND": "Agg", "PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment, capture_output=True, text=True, timeout=4 * PATIENCE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme(daemon: Daemon, tmp_path: Path) -> None:
    [program] = blocks("README.md")
    works(daemon, tmp_path, program)


def test_the_page(daemon: Daemon, tmp_path: Path) -> None:
    offline, online, recorded = blocks("docs/python.md")
    recorder = subprocess.Popen([PROGRAMS / "cdcrctl", "record", "-o", "run.mcap"], cwd=tmp_path, env=daemon.environment)
    works(daemon, tmp_path, offline + online)
    recorder.terminate()
    recorder.wait(PATIENCE_S)
    works(daemon, tmp_path, "import cdcr\n" + recorded)
