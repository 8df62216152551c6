"""Workflows, tox and the metadata agree with each other."""

import configparser
import re
import shutil
import subprocess
import sys
import tomllib

import pytest
import yaml


@pytest.fixture(scope="module")
def workflows(repository):
    """Return the workflows by name; the key "on" is read as true."""
    paths = (repository / ".github" / "workflows").glob("*.yml")
    return {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in paths}


@pytest.fixture(scope="module")
def tox(repository):
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(repository / "tox.ini", encoding="utf-8")
    return parser


def jobs_of(workflows):
    return [job for workflow in workflows.values() for job in workflow["jobs"].values()]


def test_workflows_have_triggers_and_read_only_tokens(workflows):
    assert {"docs", "release", "tests", "weekly"} <= set(workflows)
    for workflow in workflows.values():
        assert workflow[True]
        assert workflow["permissions"] == {"contents": "read"}


def test_actions_are_pinned_to_a_commit_with_their_version(repository):
    for path in (repository / ".github" / "workflows").glob("*.yml"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if "uses:" in line:
                assert re.search(r"uses: [\w/-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+$", line), line


def test_environments_of_the_workflows_are_those_of_tox(workflows, tox):
    named = set()
    for job in jobs_of(workflows):
        matrix = job.get("strategy", {}).get("matrix", {})
        named |= {row["toxenv"] for row in matrix.get("include", [])}
        named |= set(matrix.get("toxenv", []))
        commands = [step["run"] for step in job["steps"] if "run" in step]
        named |= {name for text in commands for name in re.findall(r"tox -e (\w+)", text)}
    assert {
        "audit",
        "py311",
        "py312",
        "py314",
        "coverage",
        "devdeps",
        "oldest",
        "lint",
        "docs",
    } <= named
    for name in named:
        assert re.fullmatch(r"py3\d+", name) or f"testenv:{name}" in tox


def test_python_versions_are_those_of_the_metadata(repository, workflows):
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    rows = workflows["tests"]["jobs"]["test"]["strategy"]["matrix"]["include"]
    assert sorted({row["python"] for row in rows}) == versions
    assert project["requires-python"] == f">={versions[0]}"


@pytest.fixture
def install(tmp_path):
    """Return a function that makes an interpreter; one without a version is a broken shim."""

    def make(path, version=None):
        path = tmp_path / path
        path.parent.mkdir(parents=True, exist_ok=True)
        answer = f"echo {version} {path}" if version else "echo not selected >&2; exit 127"
        path.write_text(f"#!/bin/sh\n{answer}\n")
        path.chmod(0o755)
        return str(path)

    return make


@pytest.mark.skipif(sys.platform == "win32", reason="needs bash")
@pytest.mark.parametrize("versions", [(), ("3.11",), ("3.11", "3.12", "3.13")])
def test_oldest_and_newest_interpreter_are_checked(repository, tmp_path, install, versions):
    install("bin/python3.13")
    paths = [install(f"pyenv/versions/{v}.4/bin/python", v) for v in versions[1:]]
    paths = [install(f"bin/python{v}", v) for v in versions[:1]] + paths
    environment = {
        "PATH": f"{tmp_path / 'bin'}:{tmp_path / 'tools'}", "PYENV_ROOT": str(tmp_path / "pyenv")
    }  # fmt: skip
    (tmp_path / "tools").mkdir()
    for tool in ("ls", "sort", "uniq"):
        (tmp_path / "tools" / tool).symlink_to(shutil.which(tool))
    result = subprocess.run(
        [shutil.which("bash"), str(repository / ".ci" / "interpreters")],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    expected = sorted({(versions[i], paths[i]) for i in (0, -1)}) if versions else []
    assert result.stdout.splitlines() == [" ".join(pair) for pair in expected]
    assert result.returncode == (0 if versions else 1)


def test_no_check_sets_the_number_of_threads(repository):
    # the library limits them itself, and the tests are to see it if it does not
    for name in (".ci/run", "tox.ini", "conftest.py", "pyproject.toml"):
        assert "NUM_THREADS" not in (repository / name).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "version, tag, message",
    [
        ("0.2", "v0.2", ""),
        ("0.2", "v0.3", "the tag v0.3 is not v0.2, the version"),
        ("0.2.dev0", "v0.2.dev0", "0.2.dev0 is a development version"),
    ],
)
def test_release_needs_the_tag_of_its_version(repository, tmp_path, version, tag, message):
    (tmp_path / ".ci").mkdir()
    (tmp_path / "scope_models").mkdir()
    source = (repository / ".ci" / "check_tag.py").read_text(encoding="utf-8")
    (tmp_path / ".ci" / "check_tag.py").write_text(source)
    (tmp_path / "scope_models" / "_version.py").write_text(f'__version__ = "{version}"\n')
    result = subprocess.run(
        [sys.executable, str(tmp_path / ".ci" / "check_tag.py"), tag],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == (1 if message else 0)
    assert message in result.stderr
