"""Configuration: defaults in code, TOML names what differs, and a mistake is an error that says what to do."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.config import Config, MotionConfig, OnlineConfig, ProjectionConfig, config_to_toml, load_config, parse_toml


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "own.toml"
    path.write_text(text)
    return path


def test_an_empty_file_is_the_defaults(tmp_path: Path) -> None:
    assert load_config(written(tmp_path, "")) == Config()


def test_a_file_changes_only_what_it_names(tmp_path: Path) -> None:
    config = load_config(
        written(tmp_path, '[projection]\nsigma_px = 3\nkernel = "huber"\n[online]\ncovariance = false')
    )
    assert config == Config(
        projection=ProjectionConfig(sigma_px=3.0, kernel="huber"), online=OnlineConfig(covariance=False)
    )
    assert isinstance(config.projection.sigma_px, float), "a whole number in the file is still a length"


def test_every_value_survives_the_way_through_toml(tmp_path: Path) -> None:
    config = Config(motion={"model": "random_walk", "velocity_density": 0.3}, online={"lag_s": math.inf})
    assert load_config(written(tmp_path, config_to_toml(config))) == config


def test_the_configuration_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().projection.sigma_px = 1.0  # pyrefly: ignore[read-only]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[projektion]\nsigma_px = 3", "unknown key projektion; did you mean projection?"),
        ("[projection]\nsigma_pix = 3", "unknown key projection.sigma_pix; did you mean projection.sigma_px?"),
        ('[projection]\nsigma_px = "3"', "projection.sigma_px must be a float, got '3'"),
        ("[projection]\nsigma_px = true", "projection.sigma_px must be a float, got True"),
        ("[solver]\nmax_iterations = 2.5", "solver.max_iterations must be a int, got 2.5"),
        ("[online]\ncovariance = 1", "online.covariance must be a bool, got 1"),
        ('[motion]\nmodel = "jerk"', "motion.model must be one of none, random_walk, constant_velocity, got 'jerk'"),
        ("motion = 3", "motion is a section, got 3"),
        ("[motion", "Expected ']'"),
        ("solver.window_s = " + "9" * 400, "solver.window_s must be a positive number"),
        ("fusion.inlier_px = 1e300", "fusion.inlier_px must be a positive number"),
        ("visibility.sigma_m = 1e-99", "visibility.sigma_m must be a positive number"),
        ("visibility.sigma_m = 1e13", "visibility.sigma_m must be a positive number"),
        ("solver.window_s = " + "9" * 5000, "4300 digits"),
        ("solver.max_iterations = " + "9" * 400, "solver.max_iterations must be a positive number"),
        ("solver = " + "[" * 100_000, "it is nested too deeply"),
        ("a." * 50_000 + "a = 1", "it is nested too deeply"),
    ],
)
def test_a_mistake_in_a_file_is_one_clear_error(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=r"own\.toml") as error:
        load_config(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


def test_sentences_and_numbers_are_not_taken_for_nested_keys() -> None:
    text = f"a = [{', '.join(['1.5'] * 500)}]\nb = \"{'One. ' * 500}\"\n'c.d' = 1"
    assert parse_toml(text) == {"a": [1.5] * 500, "b": "One. " * 500, "c.d": 1}


@pytest.mark.parametrize("value", ["0", "-1.0", "nan", "inf"])
@pytest.mark.parametrize("key", ["projection.sigma_px", "motion.acceleration_density", "solver.window_s"])
def test_every_number_must_be_positive_and_finite(tmp_path: Path, key: str, value: str) -> None:
    with pytest.raises(ValueError, match=f"{key} must be a positive number"):
        load_config(written(tmp_path, f"{key} = {value}"))


def test_a_section_is_given_by_what_differs() -> None:
    config = Config(online={"lag_s": 1, "covariance": False}, motion=MotionConfig(model="random_walk"))
    assert config.online == OnlineConfig(lag_s=1.0, covariance=False)
    assert isinstance(config.online.lag_s, float)
    assert config.motion == MotionConfig(model="random_walk")
    assert config.projection == ProjectionConfig()


def test_replacing_fields_keeps_the_rest() -> None:
    config = Config(online={"lag_s": 0.2}, projection={"sigma_px": 3.0})
    changed = config.replace(online={"covariance": False}, solver={"max_iterations": 7})
    assert changed == Config(
        online={"lag_s": 0.2, "covariance": False}, projection={"sigma_px": 3.0}, solver={"max_iterations": 7}
    )
    assert config == Config(online={"lag_s": 0.2}, projection={"sigma_px": 3.0})
    assert config.replace(online=OnlineConfig(covariance=False)) == config.replace(
        online={"covariance": False, "lag_s": 0.5}
    ), "an object is a whole section"
    assert dataclasses.replace(config, online=OnlineConfig()) == Config(projection={"sigma_px": 3.0})


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"onlin": {}}, "unknown key onlin; did you mean online?"),
        ({"online": {"lag": 0.2}}, "unknown key online.lag; did you mean online.lag_s?"),
        ({"online": {"lag_s": "0.2"}}, "online.lag_s must be a float, got '0.2'"),
        ({"online": {"covariance": 1}}, "online.covariance must be a bool, got 1"),
        ({"online": 0.2}, "online is a section, got 0.2"),
        ({"online": MotionConfig()}, "online is a section, got MotionConfig("),
        ({"solver": {"max_iterations": 2.5}}, "solver.max_iterations must be a int, got 2.5"),
        ({"solver": {"max_iterations": 10**400}}, "solver.max_iterations must be a positive number, got 1000"),
        ({"projection": {"sigma_px": 10**400}}, "projection.sigma_px must be a positive number, got 1000"),
        ({"projection": {"agreement_px": -1.0}}, "projection.agreement_px must be a positive number, got -1.0"),
        ({"projection": ProjectionConfig(sigma_px=0.0)}, "projection.sigma_px must be a positive number, got 0.0"),
    ],
)
def test_code_is_checked_as_files_are(sections: dict[str, Any], message: str) -> None:
    for make in (Config, Config().replace):
        with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
            make(**sections)


def test_numbers_of_numpy_are_numbers() -> None:
    config = Config(projection={"sigma_px": np.float32(3)}, solver={"max_iterations": np.int64(7)})
    assert config == Config(projection={"sigma_px": 3.0}, solver={"max_iterations": 7})
    assert type(config.projection.sigma_px) is float


def test_the_lag_alone_may_be_infinite(tmp_path: Path) -> None:
    assert load_config(written(tmp_path, "online.lag_s = inf")).online.lag_s == math.inf


def test_a_missing_file_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_config(tmp_path / "nothing.toml")
