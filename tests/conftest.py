"""What several tests start from: the shared recordings, if they are there, and models identified once per session."""

from __future__ import annotations

import os
import pickle
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

from stopset.core import build


def current() -> bool:
    """Whether library and binding were made from the sources as they are."""
    library = build.HERE / build.library_name()
    made = library.exists() and (build.HERE / "_binding.py").exists()
    return made and build.sources_hash().encode() in library.read_bytes()


if not current():  # sources changed since the installation: the tests are about the sources
    build.build()

WORKERS = 2


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """How many processes test: one for named files, where starting more would cost what it saves."""
    return 0 if any("::" in a or Path(a).is_file() for a in config.args) else WORKERS


ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Path of a file or folder in ../shared/data; skips where it is absent."""

    def path(name: str) -> Path:
        p = SHARED / name
        if not p.exists():
            pytest.skip(f"../shared/data/{name} is not on this machine")
        return p

    return path


@pytest.fixture(scope="session")
def schunk_file(shared_data: Callable[[str], Path]) -> Path:
    """The paper's open-loop recordings, as far as they are public."""
    return shared_data("schunk_lwa4p/open_loop.parquet")


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[], Any]], Any]:
    """What is dear and asked for by tests of several files: made by whichever worker asks first, in this run's own folder."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"
    folder.mkdir(exist_ok=True)

    def get(name: str, make: Callable[[], Any]) -> Any:
        import fcntl  # not on Windows, where these tests do not run

        place = folder / name
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # given back as the file is closed, also by a worker that dies
            if not place.exists():
                whole = folder / f"{name}.whole"
                whole.write_bytes(pickle.dumps(make()))
                whole.rename(place)
        return pickle.loads(place.read_bytes())

    return get


@pytest.fixture(scope="session")
def schunk(schunk_file: Path, once: Callable[[str, Callable[[], Any]], Any]):  # type: ignore[no-untyped-def]
    """The identification of the Schunk arm with the default settings, once per run."""
    from stopset.offline.description import load_robot
    from stopset.offline.identify.pipeline import identify

    return once("schunk", lambda: identify(load_robot("lwa4p"), [schunk_file]))


@pytest.fixture(scope="session")
def schunk_model(schunk: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its model file, with the bytes that `stopset identify --robot lwa4p` writes."""
    from stopset.artifact import save_model

    path = tmp_path_factory.mktemp("schunk") / "lwa4p.model.json"
    save_model(schunk.model, path)
    return path


@pytest.fixture(scope="session")
def schunk_start(schunk_file: Path, once: Callable[[str, Callable[[], Any]], Any]):  # type: ignore[no-untyped-def]
    """The same on the paper's definition: predictions from each trial's start, no margin."""
    from stopset.offline.description import load_robot
    from stopset.offline.identify.pipeline import Settings, identify

    return once("schunk start", lambda: identify(load_robot("lwa4p"), [schunk_file], Settings(windows="start", margin=1.0)))


@pytest.fixture(scope="session")
def ur10e_loaded(shared_data: Callable[[str], Path], once: Callable[[str, Callable[[], Any]], Any]) -> Callable[[str], Any]:
    """Of a real UR10e's recording with a load, by its name: the model identified from it, and what `diagnose` says of it."""
    from stopset.offline.description import load_robot
    from stopset.offline.diagnose import diagnose_model
    from stopset.offline.identify.pipeline import identify
    from stopset.recording import read_recordings

    def get(name: str) -> Any:
        robot, file = load_robot(shared_data("ur10e/robot.urdf")), shared_data(f"ur10e/{name}.parquet")

        def made() -> Any:
            model = identify(robot, [file]).model
            return model, diagnose_model(model, read_recordings(file, robot))[0]

        return once(f"ur10e {name}", made)

    return get


@pytest.fixture(scope="session")
def planar(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    """A known two-joint arm: folder with URDF, recording and model file; (folder, trials, Identification)."""
    from stopset.artifact import save_model
    from stopset.offline.identify.pipeline import identify
    from synthetic import arm, names, recordings, save_trials, urdf

    folder = tmp_path_factory.mktemp("planar")
    (folder / "robot.urdf").write_text(urdf(names(2)))
    trials = recordings((2.0, 0.7), (9.0, 4.0))
    save_trials(folder / "rec.parquet", trials, names(2))
    found = identify(arm(names(2)), [folder / "rec.parquet"])
    save_model(found.model, folder / "m.model.json")
    return folder, trials, found


@pytest.fixture(scope="session")
def altered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated arm: ``healthy.parquet``, its model ``m.model.json``, and ``altered.parquet``, where a spring pulls at ``bend``."""
    from stopset.cli.main import main
    from test_hidden_effects import ARM

    folder = tmp_path_factory.mktemp("altered")
    (folder / "three.urdf").write_text(ARM)
    for name, hide in (("healthy", "none"), ("altered", "spring:bend")):
        words = [
            "simulate",
            "--robot",
            str(folder / "three.urdf"),
            "--hide",
            hide,
            "--plan",
            "short",
            "--seed",
            "1",
            "--out",
            str(folder / name),
        ]
        assert main(words) == 0
        (folder / name / "recording.parquet").rename(folder / f"{name}.parquet")
    words = ["--robot", str(folder / "healthy" / "robot.urdf"), "--data", str(folder / "healthy.parquet")]
    assert main(["identify", *words, "--out", str(folder / "m.model.json"), "--accept-wide"]) == 0
    return folder


@pytest.fixture
def own_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """The effect of the effects folder's README, installed as a package of its own."""
    from stopset.effects import registry

    readme = Path(registry.__file__).with_name("README.md").read_text()
    code = re.search(r"```python\n(.*?)```", readme, re.S)
    entry = re.search(r"```toml\n.*?\n(.*?)```", readme, re.S)
    assert code is not None and entry is not None
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "hose.py").write_text(code.group(1))
    info = tmp_path / "my_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[stopset.effects]\n" + entry.group(1).replace('"', ""))
    monkeypatch.syspath_prepend(str(tmp_path))
    registry.catalogue.cache_clear()
    yield registry.get("relaxing_hose")
    monkeypatch.undo()
    registry.catalogue.cache_clear()


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    """A real browser without a screen; skips where it is not installed."""
    webdriver = pytest.importorskip("selenium.webdriver")
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("Debian's chromium and chromium-driver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    profile = tmp_path_factory.mktemp("profile")
    for word in (
        "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", f"--user-data-dir={profile}",
    ):  # fmt: skip
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=driver))
    yield chrome
    chrome.quit()
