"""The README is true: its commands exist and its examples run."""

import re

import pytest


@pytest.fixture(scope="module")
def readme(repository):
    return (repository / "README.md").read_text(encoding="utf-8")


def code_blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def test_commands(readme):
    commands = [line for block in code_blocks(readme, "bash") for line in block.splitlines()]
    assert "python -m pip install . && scope-models demo" in commands
    assert 'python -m pip install -e ".[test]" && python -m pytest' in commands


def test_python_blocks_run(readme, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = code_blocks(readme, "python")
    assert blocks
    namespace = {"__name__": "__readme__"}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), namespace)  # noqa: S102 (our own README)


def test_local_links_exist(readme, repository):
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", readme)
    local = [link for link in links if "://" not in link]
    assert local
    assert [link for link in local if not (repository / link).exists()] == []
