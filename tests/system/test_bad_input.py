# SPDX-License-Identifier: Apache-2.0
"""Tests of wrong input: one sentence on standard error, and exit code 2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.cli.main import main
from slamhive.cli.parts import sizes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.folder import Home

SWEEP = """apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: s}
spec:
  template: {spec: {algorithmRef: {name: actor}, datasetRef: {name: tiny}}}
"""
LONG = "[" + ", ".join(map(str, range(400))) + "]"


@pytest.fixture
def call(
    home: Home, monkeypatch: pytest.MonkeyPatch, run_command: Callable[..., tuple[int, str, str]]
) -> Callable[..., tuple[int, str, str]]:
    """Calls the command in this process; returns exit code, standard output and standard error."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    return run_command


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("actor", "acter", ["spec.template.spec", "unknown algorithm 'acter'", "did you mean 'actor'?"]),
        ("tiny", "tinny", ["unknown dataset 'tinny'", "did you mean 'tiny'?"]),
        ("{name: tiny}", "{name: tiny}, sensors: lidr", ["sensors", "lidr", "did you mean 'lidar'?"]),
        ("{name: tiny}", "{name: tiny}, sensors: stereo", ["sensors", "stereo", "lidar"]),
        ("{name: tiny}", "{name: tiny}, parameters: {nummer: 1}", ["nummer", "did you mean 'number'?"]),
        ("{name: tiny}", "{name: tiny}, parameters: {number: -1}", ["parameters.number", "-1", "0"]),
        ("{name: tiny}", "{name: tiny}, parameters: {number: one}", ["parameters.number", "one"]),
        (
            "{name: tiny}",
            "{name: tiny}, input: {resolution: 7}",
            ["input.resolution", "less than or equal to 1"],
        ),
        ("{name: tiny}", "{name: tiny}, input: {remap: {lidar: lidr}}", ["lidr", "did you mean 'lidar'?"]),
        (
            "spec:\n",
            "spec:\n  repetitons: 3\n",
            ["sweep.yaml:5: spec.repetitons", "did you mean 'repetitions'?"],
        ),
        ("kind: Sweep", "kind: Sweap", ["Sweap", "did you mean 'Sweep'?"]),
        ("v1alpha1", "v2", ["v2", "slamhive.io/v1alpha1"]),
        ("name: s}", "name: S_}", ["metadata.name", "S_"]),
        (
            "spec:\n",
            "spec:\n  parallelism: 2\n  parallelism: 3\n",
            ["sweep.yaml:6: ", "'parallelism' stands twice"],
        ),
        ("spec:\n", "spec: [\n", ["sweep.yaml:6: not YAML"]),
        (SWEEP, "", ["empty"]),
        (SWEEP, "- 1\n", ["sweep.yaml:1: expected an object"]),
        (SWEEP, "\x00\x01\x02", ["sweep.yaml: not YAML", "character"]),
    ],
)
def test_a_wrong_manifest_is_refused(
    before: str, after: str, words: list[str], call: Any, tmp_path: Path
) -> None:
    path = tmp_path / "sweep.yaml"
    assert before in SWEEP
    path.write_text(SWEEP.replace(before, after))
    for command in ("run", "validate"):
        code, out, err = call(command, path)
        assert (code, out) == (2, ""), err
        assert err.startswith("error: ")
        for word in words:
            assert word in err
        assert "Traceback" not in err
        assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("  matrix: [{path: parameter.act, values: [good]}]", ["matrix[0].path", "parameter.act"]),
        ("  matrix: [{path: parameters.acts, values: [good]}]", ["acts", "did you mean 'act'?"]),
        ("  matrix: [{path: algorithm, values: [actor, actr]}]", ["matrix[0].values[1]", "'actr'"]),
        (
            "  matrix: [{path: parameters.number, values: []}]",
            ["sweep.yaml:6: spec.matrix", "values", "at least 1"],
        ),
        (
            "  matrix: [{path: parameters.act, values: [good]}]\n  exclude: [{parameters.act: good}]",
            ["sweep.yaml:7: spec.exclude", "nothing is left to run"],
        ),
        (
            f"  matrix: [{{path: parameters.number, values: {LONG}}}, {{path: seed, values: {LONG}}}]",
            ["sweep.yaml:6: spec.matrix: ", "160000", "100000"],
        ),
        ("  repetitions: 100001", ["sweep.yaml:6: spec.repetitions", "10000"]),
    ],
)
def test_a_matrix_that_means_nothing_is_refused(
    lines: str, words: list[str], call: Any, tmp_path: Path
) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(f"{SWEEP}{lines}\n")
    code, out, err = call("run", path)
    assert (code, out) == (2, ""), err
    for word in words:
        assert word in err
    assert "Traceback" not in err


def test_files_that_cannot_be_read_are_named(call: Any, tmp_path: Path) -> None:
    (tmp_path / "image.yaml").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    for path, words in (
        (tmp_path / "nothing.yaml", "nothing.yaml"),
        (tmp_path, "directory"),
        (tmp_path / "image.yaml", "UTF-8"),
    ):
        for command in ("run", "plan", "validate"):
            code, out, err = call(command, path)
            assert (code, out) == (2, ""), err
            assert words in err
            assert len(err.splitlines()) == 1


def test_a_file_without_runs_is_refused(call: Any, home: Home) -> None:
    code, _, err = call("run", home.path / "tiny.yaml")
    assert code == 2
    assert "no Sweep, MappingRun or Evaluation" in err


def test_the_same_name_twice_is_refused(call: Any, tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text(f"{SWEEP}---\n{SWEEP}")
    code, _, err = call("run", path)
    assert code == 2
    assert "Sweep 's'" in err


def test_all_problems_are_told_at_once(call: Any, tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    matrix = "  matrix: [{path: algorithm, values: [acter, actr]}, {path: dataset, values: [tinny, tiny]}]\n"
    path.write_text(SWEEP + matrix)
    code, _, err = call("validate", path)
    assert code == 2
    assert sorted(word for word in ("'acter'", "'actr'", "'tinny'") if word in err) == [
        "'acter'",
        "'actr'",
        "'tinny'",
    ]


@pytest.mark.parametrize(
    ("home", "words"),
    [("/dev/null/home", "SLAMHIVE_HOME"), ("/proc/home", "SLAMHIVE_HOME")],
    indirect=False,
)
def test_a_home_that_cannot_be_made_is_named(
    home: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(SWEEP)
    monkeypatch.setenv("SLAMHIVE_HOME", home)
    monkeypatch.setattr("sys.argv", ["slamhive", "run", str(path)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert words in capsys.readouterr().err


def test_an_archive_that_is_none_is_named(call: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(SWEEP)
    monkeypatch.setenv("SLAMHIVE_ARCHIVE", "mysql://x/y")
    code, _, err = call("run", path)
    assert code == 2
    assert "mysql://…" in err


@pytest.mark.parametrize("command", ["results list", "report"])
@pytest.mark.parametrize("url", ["mysql://me:{}@x/y", "postgresql://me:{}@h:5 4/y"])
def test_no_command_tells_the_databases_password(
    command: str, url: str, call: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_ARCHIVE", url.format("S3cret-canary"))
    code, out, err = call(*command.split())
    assert code == 2
    assert "is not a database URL" in err
    assert "S3cret-canary" not in out + err


@pytest.mark.parametrize(
    "arguments", [["runn"], ["run"], ["run", "--jobs", "2"], ["run", "-j", "0", "x.yaml"]]
)
def test_a_wrong_command_line_is_refused(arguments: list[str], call: Any) -> None:
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert "Usage" in err


@pytest.fixture
def templated(home: Home) -> str:
    """An algorithm of the home with two settings files."""
    folder = home.path / "algorithms" / "templated"
    folder.mkdir()
    (folder / "algorithm.yaml").write_text(TEMPLATED)
    return "templated"


TEMPLATED = """apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: templated}
spec:
  image: example.org/templated:1
  modes: [{name: lidar}]
  output: {frame: lidar}
  parameters:
    size: {type: Number, default: 2}
    name: {type: String, default: none}
  files:
    - path: a/b.yaml
      template: |
        size: {{ 1 / parameters.size }}
        name: {{ parameters.name|quoted }}
    - {path: c.txt, template: "{{ mode }}"}
"""


def test_settings_files_are_printed_and_written(
    templated: str, call: Callable[..., Any], tmp_path: Path
) -> None:
    code, out, err = call("algorithm", "render", templated, "tiny", "-p", "size=8", "-p", "name=12:30=x")
    assert (code, err) == (0, "")
    assert out == '==> a/b.yaml <==\nsize: 0.125\nname: "12:30=x"\n==> c.txt <==\nlidar\n'
    for size, text in ((4, "0.25"), (1, "1.0")):
        folder = tmp_path / "out"
        code, out, _ = call("algorithm", "render", templated, "tiny", "-p", f"size={size}", "-o", folder)
        assert (code, out.split()) == (0, [str(folder / "a/b.yaml"), str(folder / "c.txt")])
        assert (folder / "a/b.yaml").read_text() == f'size: {text}\nname: "none"\n'


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["actor", "tiny"], "algorithm 'actor' has no settings files"),
        (["templatet", "tiny"], "unknown algorithm 'templatet'; did you mean 'templated'?"),
        (["templated", "tinny"], "unknown dataset 'tinny'; did you mean 'tiny'?"),
        (["templated", "tiny", "-p", "size"], "-p size: expected NAME=VALUE"),
        (["templated", "tiny", "-p", "size=1", "-p", "size=2"], "'size' was given before"),
        (["templated", "tiny", "-p", "size=[1]"], "-p size=[1]: expected a single value"),
        (["templated", "tiny", "-p", "size={"], "not YAML"),
        (["templated", "tiny", "-p", "size=big"], "parameters.size: 'big' is not allowed, only a number"),
        (["templated", "tiny", "-p", "sise=1"], "did you mean 'size'?"),
        (["templated", "tiny", "-p", "size=0"], "files.0.template (a/b.yaml): line 1: division by zero"),
        (["templated", "tiny", "--mode", "stereo"], "stereo"),
        (["templated", "tiny", "-o", "/proc/nowhere"], "--output: "),
    ],
)
def test_settings_files_that_can_not_be_rendered(
    arguments: list[str], words: str, templated: str, call: Callable[..., Any]
) -> None:
    code, out, err = call("algorithm", "render", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert "Traceback" not in err


def test_a_template_that_is_none_is_told_with_its_file_field_and_line(
    home: Home, call: Callable[..., Any]
) -> None:
    path = home.path / "wrong.yaml"
    path.write_text(TEMPLATED.replace("parameters.size", "parameters.sise"))
    code, _, err = call("validate", path)
    assert code == 2
    assert f"{path}:4: spec: files.0.template: line 1: unknown parameter 'sise'; did you mean 'size'?" in err


def test_what_a_cluster_finds_too_large_is_said_before_one_is_asked(
    tmp_path: Path, call: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(SWEEP + "  matrix: [{path: parameters.number, values: " + LONG + "}]\n")
    assert call("validate", path)[2] == ""
    monkeypatch.setattr(sizes, "ANNOTATION_BYTES", 1000)
    code, out, err = call("validate", path)
    assert (code, out) == (0, "Sweep s: 400 runs\n")
    said = " ".join(err.split())
    assert "too many for kubectl apply" in said
    assert "at most 1,000: slamhive submit, kubectl create and kubectl apply --server-side take it" in said
    monkeypatch.setattr(sizes, "OBJECT_BYTES", 999)
    told = "a cluster takes at most 999 of an object: write a range in the place of long lists"
    assert told in " ".join(call("validate", path)[2].split())
    code, _, err = call("submit", path)
    assert (code, told in " ".join(err.split())) == (2, True)
    assert f"{path}:1: Sweep s: " in " ".join(err.split())
