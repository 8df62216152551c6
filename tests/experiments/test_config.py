"""Studies made of names and values."""

import dataclasses
import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from scope_models.experiments.study import Study, parameter

from scope_models.experiments import STUDIES, make_study, read_config


@dataclass(frozen=True, kw_only=True)
class Fields(Study):
    """One field of every kind."""

    name: ClassVar[str] = "fields"

    number: float = 1.0
    count: int = 1
    text: str = ""
    flag: bool = False
    numbers: tuple[float, ...] = ()
    texts: tuple[str, ...] = ()
    maybe: float | None = None

    def tasks(self):
        return []

    def summarize(self, table):
        return table

    def draw(self, table, summary):  # noqa: ARG002
        return None


@dataclass(frozen=True, kw_only=True)
class Grid(Study):
    """Stars of a grid.

    Each is a cell.

    Notes
    -----
    What follows stays where it is.
    """

    name: ClassVar[str] = "grid"
    grid: ClassVar[dict] = {"index": "stars", "mag": "mags", "kind": "kinds"}
    key: ClassVar[str] = "kp{mag:g}-{kind}-{index}"

    stars: int = parameter(2, "Stars per cell.", least=1)
    mags: tuple[float, ...] = parameter((12.0,), "Magnitudes.", different="numbers")
    kinds: tuple[str, ...] = parameter(("a", "b"), "Kinds.", among=("a", "b"))
    kind: str = parameter("a", "A kind.", among=("a", "b"))
    floor: float = parameter(0.0, "At least 0.", positive=False)
    scales: tuple[float, ...] = parameter((1.0,), "Above 0.", positive=True)
    other: float = -1.0

    def summarize(self, table):
        return table

    def draw(self, table, summary):  # noqa: ARG002
        return None


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "study.toml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("name", STUDIES)
class TestEveryStudy:
    def test_has_its_name(self, name):
        assert STUDIES[name].name == name

    def test_config_makes_it_again(self, name):
        study = make_study(name)
        config = study.config()
        assert config.pop("study") == name
        assert make_study(name, config) == study

    def test_pickles(self, name):
        study = make_study(name)
        assert pickle.loads(pickle.dumps(study)) == study  # noqa: S301

    def test_tasks_have_unique_keys(self, name):
        keys = [task["key"] for task in make_study(name).tasks()]
        assert len(set(keys)) == len(keys) > 0

    def test_every_field_is_documented(self, name):
        for item in dataclasses.fields(STUDIES[name]):
            assert item.name in STUDIES[name].__doc__


class TestFields:
    def test_values_come_in_the_types_of_the_fields(self):
        study = Fields(number=2, numbers=np.array([1, 2]), texts=["a"], maybe=3, count=np.int64(4))
        assert (study.number, study.numbers, study.texts, study.maybe) == (
            2.0,
            (1.0, 2.0),
            ("a",),
            3,
        )
        assert [type(value) for value in (study.number, study.numbers[0])] == [float, float]
        assert type(study.count) is int

    def test_config_is_plain(self):
        assert Fields(numbers=(1, 2)).config() == {
            "study": "fields", "seed": 1, "number": 1.0, "count": 1, "text": "", "flag": False,
            "numbers": [1.0, 2.0], "texts": [], "maybe": None,
        }  # fmt: skip

    @pytest.mark.parametrize(
        "field, value, message",
        [
            ("number", "1", "`number` must be a number, got '1'"),
            ("number", True, "`number` must be a number, got True"),
            ("number", float("nan"), "`number` must be finite, got nan"),
            ("count", 1.0, "`count` must be an integer, got 1.0"),
            ("count", True, "`count` must be an integer, got True"),
            ("text", 1, "`text` must be a string, got 1"),
            ("flag", 1, "`flag` must be true or false, got 1"),
            ("numbers", 1.0, "`numbers` must be a list, got 1.0"),
            ("numbers", ["a"], "`numbers` must be a number, got 'a'"),
            ("texts", "ab", "`texts` must be a list, got 'ab'"),
            ("maybe", "a", "`maybe` must be a number, got 'a'"),
            ("seed", -1, "`seed` must be at least 0, got -1"),
        ],
    )
    def test_wrong_values(self, field, value, message):
        with pytest.raises((TypeError, ValueError)) as caught:
            Fields(**{field: value})
        assert str(caught.value) == message

    def test_files_are_found_in_the_fields(self, tmp_path):
        paths = [tmp_path / name for name in "ab"]
        for path in paths:
            path.touch()
        study = Fields(text=str(paths[0]), texts=[str(paths[1]), "k2_roll", str(tmp_path)])
        assert study.input_files() == [str(path) for path in paths]


class TestParameters:
    def test_docstring_lists_them(self):
        assert Grid.__doc__ == (
            "Stars of a grid.\n\nEach is a cell.\n\nParameters\n----------\n"
            "seed : int, optional\n    Seed of all random numbers.\n"
            "stars : int, optional\n    Stars per cell.\n"
            "mags : tuple of float, optional\n    Magnitudes.\n"
            "kinds : tuple of str, optional\n    Kinds.\n"
            'kind : {"a", "b"}, optional\n    A kind.\n'
            "floor : float, optional\n    At least 0.\n"
            "scales : tuple of float, optional\n    Above 0.\n\n"
            "Raises\n------\nTypeError, ValueError\n"
            "    If a field is of the wrong type or outside its domain.\n\n"
            "Notes\n-----\nWhat follows stays where it is.\n"
        )
        assert "Parameters" not in Fields.__doc__

    @pytest.mark.parametrize(
        "field, value, message",
        [
            ("stars", 0, "`stars` must be at least 1, got 0"),
            ("mags", (), "`mags` must be one or more different numbers, got ()"),
            ("mags", (1, 1), "`mags` must be one or more different numbers, got (1.0, 1.0)"),
            ("kinds", ("a", "c"), "`kinds` must be among a, b, got 'c'"),
            ("kind", "c", "`kind` must be a or b, got 'c'"),
            ("floor", -1, "`floor` must not be negative, got -1.0"),
            ("scales", (1, 0), "`scales` must be positive, got 0.0"),
        ],
    )
    def test_domains(self, field, value, message):
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            Grid(**{field: value})
        assert str(caught.value) == message

    def test_tasks_are_the_cells_of_the_grid(self):
        tasks = Grid(mags=(12, 13.5), kinds=("b",)).tasks()
        assert [task["key"] for task in tasks] == [
            "kp12-b-0", "kp13.5-b-0", "kp12-b-1", "kp13.5-b-1"
        ]  # fmt: skip
        assert list(tasks[1].items()) == [
            ("key", "kp13.5-b-0"), ("mag", 13.5), ("kind", "b"), ("index", 0)
        ]  # fmt: skip

    def test_what_a_study_lacks_is_named(self):
        with pytest.raises(NotImplementedError, match="`fields` has neither a grid nor tasks"):
            Study.tasks(Fields())
        with pytest.raises(NotImplementedError, match="`fields` has no pixels"):
            Fields().run_star({})


class TestSeeds:
    def test_depend_on_seed_key_and_purpose_only(self):
        seeds = {
            Fields(seed=seed).star_seed(key, purpose)
            for seed in (1, 2)
            for key in ("a", "b")
            for purpose in ("", "motion")
        }
        assert len(seeds) == 8
        assert Fields(number=5.0).star_seed("a") == Fields().star_seed("a")
        assert all(0 <= seed < 2**53 for seed in seeds)

    def test_generators_follow_the_seeds(self):
        first, again, other = (Fields().star_rng(key).random() for key in ("a", "a", "b"))
        assert first == again != other

    def test_are_fixed_forever(self):
        # Results that are on disk would not go with new ones.
        assert Fields().star_seed("star0") == 3551982543959318


class TestReading:
    def test_fields_come_from_the_file(self, write):
        study = read_config(write('study = "table1"\nscales = [1, 3.5]\ncadences = 50\n'))
        assert study == make_study("table1", {"scales": (1, 3.5), "cadences": 50})

    def test_given_values_go_first(self, write):
        path = write("cadences = 50\nscales = [1]\n")
        study = read_config(path, "table1", {"cadences": 60})
        assert (study.cadences, study.scales) == (60, (1.0,))

    @pytest.mark.parametrize(
        "text, message",
        [
            ('study = "table2"', "there is no study 'table2'; the studies are "),
            ("cadences = 50", 'must name a study: study = "NAME"'),
            ("study = 3", "there is no study 3"),
            (
                'study = "table1"\nscale = 1',
                "`table1` has no field `scale`; its fields are seed, ",
            ),
            ('study = "table1"\nscales = 1', "`scales` must be a list, got 1"),
            ('study = "table1"\ncadences = "x"', "`cadences` must be an integer, got 'x'"),
            ('study = "table1"\ncadences = 1', "`cadences` must be at least 2, got 1"),
            ('study = "table1"\n[motions]\na = 1', "`motions` must be a list, got {'a': 1}"),
            ("study = table1", "is not valid TOML: Invalid value"),
        ],
    )
    def test_bad_files(self, write, text, message):
        path = write(text)
        with pytest.raises((TypeError, ValueError)) as caught:
            read_config(path)
        assert str(caught.value).startswith(str(path))
        assert message in str(caught.value)

    def test_not_text(self, tmp_path):
        path = tmp_path / "study.toml"
        path.write_bytes(b"\xff\xfe\x00")
        with pytest.raises(ValueError, match="is not valid TOML"):
            read_config(path)

    def test_no_file(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            read_config(tmp_path / "absent.toml")

    def test_another_study(self, write):
        with pytest.raises(
            ValueError, match="is a configuration of the study 'table1', not 'motion'"
        ):
            read_config(write('study = "table1"'), "motion")
