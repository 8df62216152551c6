"""Studies made of names and values."""

import dataclasses
import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from scope_models.experiments import STUDIES, make_study, read_config
from scope_models.experiments.study import Study


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
