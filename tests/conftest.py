# SPDX-License-Identifier: Apache-2.0
"""The order of all tests, hypothesis' profiles, and a home with a small dataset and an algorithm.

The order is drawn at random: its seed is printed first, and ``--order-seed`` repeats it.
"""

from __future__ import annotations

import fcntl
import gc
import os
import shutil
import signal
import subprocess
import sys
import uuid
from collections import defaultdict
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from random import Random, SystemRandom
from typing import TYPE_CHECKING, Any

import pytest
from aiohttp.client_proto import ResponseHandler
from hypothesis import settings as hypothesis_settings
from rosbags.serde import cdr, ros1

from slamhive.data.files.once import evict, in_use
from slamhive.data.store.datasets import materialise
from slamhive.local.home.folder import Home
from slamhive.local.programs.engines import ContainerChoice, Engine, find_engine
from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tools")]
from browsers import MISSING, Browser, find_browser
from furnishing import ACTOR, furnish
from sharing import Sharing
from units import STORY, Durations, Units

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

TESTS = Path(__file__).parent
PAPER = TESTS.parents[1] / "shared" / "data" / "icra2023"
NEEDS = {
    "control_plane": ("cluster",),
    "node_cluster": ("cluster", "node"),
    "ros": ("ros",),
    "helm": ("helm",),
    "podman": ("container",),
    "rerun": ("slow",),
}
"""Markers of the tests that ask for a fixture."""
LONG = {"slow", "image", "ros", "container", "cluster"}
"""Markers of tests that may take longer than the usual five minutes."""
CONTAINER_IMAGES = (
    *("kiss-icp", "shell-algorithm"),
    *("ros1-player", "kiss-icp-ros"),
    *("ros2-player", "kiss-icp-ros2"),
)
"""Images that tests run in containers of a workstation, as images/build calls them."""
POSTGRESQL = "SLAMHIVE_TEST_POSTGRESQL"
"""Variable that names a PostgreSQL server for tests."""
INSTALLING = {"environments", "evo"}
"""Fixtures that install packages where no session before has: what uses one may wait for that."""
RECORDINGS_BYTES = 4 * 2**30
"""Of generated recordings that outlive sessions; those that were used least recently go."""
PROFILE = os.environ.get("SLAMHIVE_EXAMPLES", "quick")

hypothesis_settings.register_profile("quick", max_examples=40, deadline=None, derandomize=True, database=None)
hypothesis_settings.register_profile("thorough", max_examples=2000, deadline=None, print_blob=True)
hypothesis_settings.load_profile(PROFILE)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options for workers and for an order that is repeated."""
    group = parser.getgroup("workers")
    group._addoption("-n", dest="workers", type=int, default=0, help="run tests in so many processes")
    parser.addoption("--order-seed", type=int, help="run tests in the order that was drawn from this number")


def pytest_configure(config: pytest.Config) -> None:
    """Draw the seed, share the tests out, and have Ctrl-C work.

    Where a developer's shell has its home and archive is nothing to the tests.
    """
    for name in ("HOME", "ARCHIVE", "ALSO", "CONTAINER"):
        os.environ.pop(f"SLAMHIVE_{name}", None)
    if config.option.order_seed is None:
        config.option.order_seed = SystemRandom().randrange(2**32)
    # A shell has what it puts into the background ignore SIGINT, and programs of tests would inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    durations = Durations(kept("durations") / "seconds.json")
    config.pluginmanager.register(Sharing(config.option.workers, durations, Units(durations)))


def pytest_report_header(config: pytest.Config) -> str:
    """Print what repeats the order."""
    return f"--order-seed {config.option.order_seed}, hypothesis profile {PROFILE}"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print it once more beside the failures, and where there is no header."""
    terminalreporter.write_line(pytest_report_header(config))


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Look for no garbage while all modules are imported: they leave little, and it takes a tenth of that."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()  # what has been imported stays


@pytest.hookimpl(tryfirst=True)  # before pytest brings together the tests that share a fixture
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what tests need, give what may take long more time, and put the tests in the order of the seed."""
    files = defaultdict(list)
    for item in items:
        fixtures = set(getattr(item, "fixturenames", ()))
        for fixture in NEEDS.keys() & fixtures:
            for marker in NEEDS[fixture]:
                item.add_marker(marker)
        names = {marker.name for marker in item.iter_markers()}
        if "timeout" not in names and (INSTALLING & fixtures or LONG & names):
            item.add_marker(pytest.mark.timeout(1800))
        files[item.nodeid.partition("::")[0]].append(item)
    seed = config.option.order_seed
    names = sorted(files)
    Random(seed).shuffle(names)
    names.sort(key=lambda name: name if name.startswith(STORY) else "")
    for name in names:
        if not name.startswith(STORY):  # the same order when the file is run alone
            Random(f"{seed} {name}").shuffle(files[name])
    items[:] = [item for name in names for item in files[name]]


@pytest.fixture(scope="session", autouse=True)
def _connections_end_at_once() -> None:
    """Have connections with TLS end without saying goodbye to the server.

    Those of a watch that is cancelled say goodbye in the background. Where the server is slow to answer and
    the test's loop ends before, one is found open when garbage is collected, in whichever test that is.
    """
    ResponseHandler.close = ResponseHandler.abort  # type: ignore[method-assign]


@pytest.fixture(scope="session", autouse=True)
def _messages_are_compiled_once() -> None:
    """Have rosbags compile its functions for a message once, not for each recording."""
    compiled = cache(lambda lines, new=cdr.compile_lines: new(lines))
    cdr.compile_lines = ros1.compile_lines = lambda lines: compiled(tuple(lines))


@pytest.fixture(autouse=True)
def _process_as_it_was() -> Iterator[None]:
    """Umask and SIGTERM's handler, put back behind a test that ran the program of a Job in this process.

    Else a test that comes later by chance writes files that no other user can read.
    """
    mask = os.umask(0)
    os.umask(mask)
    handler = signal.getsignal(signal.SIGTERM)
    yield
    os.umask(mask)
    if signal.getsignal(signal.SIGTERM) is not handler:
        signal.signal(signal.SIGTERM, handler)


def kept(name: str) -> Path:
    """Return a folder of what outlives sessions."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    folder = cache / "slamhive-tests" / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def environments() -> Path:
    """A folder of environments that all homes share and that outlives the session: making one takes seconds.

    An environment is named by its content and made under a lock, by whoever needs it first.
    """
    return kept("environments")


@pytest.fixture(scope="session")
def lend_recording() -> Iterator[Callable[[Dataset, Path], None]]:
    """A function that links a generated dataset into a home; it outlives sessions: making one takes minutes.

    Its folder is named by the generator's code and what it is asked for, and is made under a lock.
    """
    folder = kept("recordings")
    with ExitStack() as stack:

        def lend(dataset: Dataset, home: Path) -> None:
            made = materialise(dataset, folder, folder).root
            stack.enter_context(in_use(made))
            datasets = home / "datasets"
            datasets.mkdir(parents=True, exist_ok=True)
            (datasets / made.name).symlink_to(made)

        yield lend
    evict(folder, RECORDINGS_BYTES)


@pytest.fixture(scope="session")
def share(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """A function that returns a folder of the session by its name; the first worker that asks fills it."""

    def folder_of(name: str, fill: Callable[[Path], None]) -> Path:
        folder = tmp_path_factory.getbasetemp() / "shared" / name
        folder.parent.mkdir(exist_ok=True)
        with folder.with_suffix(".lock").open("w", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not folder.exists():
                folder.mkdir()
                try:
                    fill(folder)
                except BaseException:
                    shutil.rmtree(folder)
                    raise
        return folder

    return folder_of


@pytest.fixture(scope="session")
def tiny(share: Callable[..., Path]) -> Path:
    """A folder of datasets in which the small recording has been made."""

    def fill(folder: Path) -> None:
        dataset = load_file(ACTOR / "tiny.yaml")[0]
        assert isinstance(dataset, Dataset)
        materialise(dataset, folder, folder)
        (folder / "tiny").mkdir()
        shutil.copyfile(ACTOR / "tiny.yaml", folder / "tiny" / "dataset.yaml")

    return share("datasets", fill)


@pytest.fixture(scope="session")
def paper_home(share: Callable[..., Path]) -> Callable[..., Path]:
    """A function that returns a home with the 81 runs of the original paper, aligned in each way it names.

    Tests share it: they read it alone.
    """
    if not PAPER.is_dir():
        pytest.skip("the runs of the original paper are not there (../shared/data/icra2023)")
    from typer.testing import CliRunner

    from slamhive.cli import importing

    def home_of(*alignments: str) -> Path:
        def fill(home: Path) -> None:
            for alignment in alignments:
                truth = ("--ground-truth", str(PAPER / "groundtruth"), "--alignment", alignment)
                outcome = CliRunner().invoke(
                    importing.app,
                    ["slam-hive", str(PAPER / "runs"), *truth],
                    env={"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": ""},
                )
                assert outcome.exit_code == 0, outcome.output
                assert "81 runs evaluated" in outcome.output

        return share(f"paper-{'-'.join(alignments)}", fill)

    return home_of


@pytest.fixture(scope="session")
def postgresql_server() -> Iterator[str]:
    """A PostgreSQL server: the one that the variable names, or one of our own in a temporary folder."""
    given = os.environ.get(POSTGRESQL)
    if given:
        yield given
        return
    sys.path.append(str(TESTS / "archive"))
    from servers import postgresql

    with postgresql() as own:
        if own is None:
            pytest.skip(f"no PostgreSQL here: apt-get install postgresql, or let {POSTGRESQL} name a server")
        yield own.url


@pytest.fixture(scope="session")
def chromium() -> str:
    """The program of a browser."""
    return find_browser() or pytest.skip(MISSING)


@pytest.fixture(scope="session")
def browser(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all tests."""
    pytest.importorskip("websocket", reason="no websocket-client here: pip install websocket-client")
    with Browser(chromium, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def postgresql_url(postgresql_server: str) -> Iterator[str]:
    """The URL of an empty database in PostgreSQL."""
    pytest.importorskip("psycopg")
    from sqlalchemy import create_engine, make_url, text

    base = make_url(postgresql_server).set(drivername="postgresql+psycopg")
    name = f"slamhive_{uuid.uuid4().hex[:12]}"
    admin = create_engine(base, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    yield base.set(database=name).render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture(scope="session")
def podman() -> Engine:
    """Podman, with the images that tests run in containers of a workstation."""
    if os.geteuid() != 0:
        pytest.skip("containers are tested as root")
    try:
        found = find_engine(ContainerChoice.PODMAN)
    except Unavailable as error:
        pytest.skip(f"{error} (make test-packages)")
    # What is up to date is not built again.
    build = [TESTS.parent / "images" / "build", "--tool", "buildah", *CONTAINER_IMAGES]
    built = subprocess.run(build, capture_output=True, text=True, check=False, timeout=1500)
    if built.returncode:
        pytest.skip(f"the images can't be built: {built.stderr.strip()[-500:]}")
    return found


@pytest.fixture(scope="session")
def image_of(podman: Engine) -> Callable[[Path, str], str]:
    """Builds the image that a folder's Dockerfile describes, under a name, and returns its whole name."""
    assert podman.is_podman
    sys.path.insert(0, str(TESTS.parent / "images"))
    from building.base import STAND_IN
    from building.recipes import Recipe
    from building.tools import Buildah

    def build(folder: Path, name: str) -> str:
        recipe = Recipe(name, f"library/{name}:1", folder / "Dockerfile", folder, "", "")
        Buildah(folder).build(recipe, STAND_IN, {})
        return recipe.reference

    return build


@pytest.fixture
def run_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Calls the command in this process; returns exit code, standard output and standard error."""
    from slamhive.cli.main import main

    def call(*words: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["slamhive", *map(str, words)])
        code: Any = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        return code or 0, *capsys.readouterr()

    return call


@pytest.fixture
def home(tmp_path: Path, environments: Path, tiny: Path) -> Home:
    """A home of its own for each test, with the small dataset and the actor."""
    folder = furnish(tmp_path / "home", environments, tiny)
    shutil.copyfile(ACTOR / "tiny.yaml", folder / "tiny.yaml")
    return Home.at(folder)
