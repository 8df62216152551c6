"""Workflows, tox and the metadata agree with each other."""

import configparser
import re
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
