"""What holds for the package as a whole: metadata, names, documentation, imports."""

import importlib
import importlib.metadata
import importlib.resources
import inspect
import pkgutil
import re
import subprocess
import sys
import tomllib

import pytest
import yaml

import scope_models

MODULES = sorted(
    module.name for module in pkgutil.walk_packages(scope_models.__path__, "scope_models.")
)
PUBLIC_MODULES = [
    "scope_models",
    *(name for name in MODULES if not any(part.startswith("_") for part in name.split("."))),
]
HEAVY_MODULES = ["lightkurve", "matplotlib", "pandas", "photutils"]


def public_objects():
    """Return the functions and classes in `__all__` of the public modules, each one once."""
    objects = {}
    for module_name in PUBLIC_MODULES:
        module = importlib.import_module(module_name)
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isclass(value) or inspect.isfunction(value):
                objects[f"{value.__module__}.{value.__qualname__}"] = value
    return objects


PUBLIC_OBJECTS = public_objects()


@pytest.fixture(scope="module")
def pyproject(repository):
    return tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["scope_models", *MODULES])
def test_all_is_true(name):
    # ruff (RUF022) sees to the order.
    module = importlib.import_module(name)
    assert len(module.__all__) == len(set(module.__all__))
    assert [item for item in module.__all__ if not hasattr(module, item)] == []


@pytest.mark.parametrize(
    "name", [name for name in MODULES if hasattr(importlib.import_module(name), "__path__")]
)
def test_packages_offer_public_names_and_modules_only(name):
    """What a tab completes."""
    module = importlib.import_module(name)
    offered = {item for item in dir(module) if not item.startswith("_")}
    modules = {item.rpartition(".")[2] for item in MODULES if item.rpartition(".")[0] == name}
    assert offered <= set(module.__all__) | modules


def test_common_names_in_one_line():
    names = "Detector Motion PLDCorrector Scene Star cdpp fit_tpf inject read_pixels"
    assert set(names.split()) | {"simulate", "write_tpf"} <= set(dir(scope_models))


@pytest.mark.parametrize("name", sorted(PUBLIC_OBJECTS))
def test_public_names_have_an_example(name):
    value = PUBLIC_OBJECTS[name]
    if inspect.isclass(value) and issubclass(value, Warning):
        return
    docstring = inspect.getdoc(value)
    assert "Examples\n--------" in docstring
    assert ">>> " in docstring


def test_import_is_light():
    code = f"import sys, scope_models; print([m for m in {HEAVY_MODULES} if m in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_version_description_and_dependencies_are_the_same_everywhere(repository, pyproject):
    project = pyproject["project"]
    recipe = (repository / "recipe" / "meta.yaml").read_text(encoding="utf-8")
    version = re.search(r'version = "(.*)"', recipe)[1]
    recipe = yaml.safe_load(re.sub(r"{%.*?%}|{{.*?}}", "", recipe))
    others = {
        name: yaml.safe_load((repository / name).read_text(encoding="utf-8"))
        for name in ("CITATION.cff", "codemeta.json", ".zenodo.json")
    }
    assert {version, others["CITATION.cff"]["version"], others["codemeta.json"]["version"]} == {
        scope_models.__version__
    }
    assert {recipe["about"]["summary"], others["CITATION.cff"]["abstract"]} == {
        project["description"]
    }
    assert {others[name]["description"] for name in ("codemeta.json", ".zenodo.json")} == {
        project["description"]
    }
    conda = {"lazy_loader": "lazy-loader", "matplotlib": "matplotlib-base"}
    needed = [requirement.split(">=") for requirement in project["dependencies"]]
    assert recipe["requirements"]["run"] == [
        f"python {project['requires-python']}",
        *(f"{conda.get(name, name)} >={least}" for name, least in needed),
    ]
    changes = (repository / "CHANGES.rst").read_text(encoding="utf-8")
    assert changes.startswith(re.sub(r"\.?dev\d+$", "", scope_models.__version__))


def test_types_are_marked():
    assert (importlib.resources.files(scope_models) / "py.typed").is_file()


def test_installed_metadata():
    try:
        metadata = importlib.metadata.metadata("scope_models")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("scope_models is not installed")
    assert metadata["Version"] == scope_models.__version__
    scripts = importlib.metadata.entry_points(group="console_scripts", name="scope-models")
    assert [script.value for script in scripts] == ["scope_models.cli:main"]


def test_oldest_versions_in_tox_are_those_of_the_metadata(repository, pyproject):
    minimum = dict(
        requirement.split(">=")
        for requirement in pyproject["project"]["dependencies"]
        + pyproject["project"]["optional-dependencies"]["test"]
    )
    oldest = (repository / "tox.ini").read_text(encoding="utf-8")
    oldest = oldest.split("[testenv:oldest]")[1].split("[testenv:")[0]
    pins = dict(re.findall(r"^    ([\w-]+)==([\d.]+?)(?:\.\*)?$", oldest, re.MULTILINE))
    assert {name: pins.get(name) for name in minimum} == minimum


def reference_names(repository):
    """Return the public names that the reference documents, as objects' own and as given."""
    pages = (repository / "docs" / "reference").glob("*.rst")
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    names, current = set(), ""
    for line in text.splitlines():
        if found := re.match(r"\.\. automodapi:: (\S+)$", line):
            current = found[1]
            module = importlib.import_module(current)
            public = {name for name in module.__all__ if callable(getattr(module, name))}
            names |= {f"{current}.{name}" for name in public}
        elif line.strip() == ":include-all-objects:":
            names |= {f"{current}.{name}" for name in module.__all__}
        elif found := re.match(r" +:skip: (\S+)$", line):
            names.discard(f"{current}.{found[1]}")
        elif found := re.match(r"\.\. py:data:: (\S+)$", line):
            names.add(f"{current}.{found[1]}")
    return names


def test_reference_has_every_public_name(repository):
    documented = reference_names(repository)
    objects = []
    for name in documented:
        module_name, _, attribute = name.rpartition(".")
        objects.append(getattr(importlib.import_module(module_name), attribute))
    missing = []
    for module_name in PUBLIC_MODULES:
        module = importlib.import_module(module_name)
        for name in module.__all__:
            value = getattr(module, name)
            # A name may be documented where another module provides the same object.
            if not any(value is item for item in objects) and name != "__version__":
                missing.append(f"{module_name}.{name}")
    assert missing == []
