"""The job file: every option of `radiant run` and no other key, paths relative to the file, one sentence for everything else."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.config.run_config import RunConfig, SfmOptions, TrainOptions
from radiant_app.files.job_file import Job, load_jobs
from radiant_core.errors import BadInput

TWO = """
[defaults]
steps = 10
system = "fleet.toml"

[[job]]
name = "a"
source = "photos"

[[job]]
name = "b"
source = "photos"
out = "deep/b"
steps = 20
matching = "spatial"
"""


def jobs_of(folder: Path, text: str) -> tuple[Job, ...]:
    (folder / "photos").mkdir(exist_ok=True)
    (folder / "fleet.toml").touch()
    path = folder / "night.toml"
    path.write_text(text)
    return load_jobs(path, folder / "batch")


def test_jobs_arrive_in_order_with_their_own_options_before_the_defaults(tmp_path: Path) -> None:
    a, b = jobs_of(tmp_path, TWO)
    photos, fleet = tmp_path / "photos", tmp_path / "fleet.toml"
    config = RunConfig(source=photos, out=tmp_path / "batch" / "a", system=fleet, train=TrainOptions(num_steps=10))
    assert (a.name, a.config, a.input_files) == ("a", config, (tmp_path / "fleet.toml",))
    other = replace(config, out=tmp_path / "batch" / "deep" / "b", train=TrainOptions(num_steps=20), sfm=SfmOptions(matching="spatial"))
    assert (b.name, b.config) == ("b", other)


def test_every_option_of_the_command_is_a_key_but_those_that_the_batch_sets(tmp_path: Path) -> None:
    help_text = CliRunner().invoke(app, ["run", "--help"], env={"COLUMNS": "300"}).output
    options = set(re.findall(r"--([a-z][a-z-]*)", help_text)) - {"help", "json", "resume", "out", "verbose"}
    assert options >= {"system", "train-preset", "steps", "long-side-px", "max-splats", "seed", "workers"}
    [job] = jobs_of(tmp_path, '[[job]]\nname = "a"\nsource = "photos"\nset = ["train.sky=false", "plan.method=even"]\n')
    assert (job.config.train.settings, job.config.plan.method) == ({"sky": False}, "even")
    for option in options - {"set"}:
        with pytest.raises(BadInput, match=rf"job\[0\]\.{option} is \[\]; expected "):
            # No other option takes a list, so that each known key is named with its own
            # expectation.
            jobs_of(tmp_path, f'[[job]]\nname = "a"\nsource = "photos"\n{option} = []\n')


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("steps = 20", "step = 20", "job[1].step is not a key of a job file: did you mean steps?"),
        ("steps = 20", 'steps = "20"', "job[1].steps is '20'; expected a valid integer"),
        ("steps = 20", "steps = 0", "job[1].steps is 0; expected greater than or equal to 1"),
        ("steps = 20", "steps = true", "job[1].steps is True; expected a valid integer"),
        ("steps = 20", "resume = true", "job[1].resume is not a key"),
        ("steps = 10", "steps = -1", "defaults.steps is -1"),
        ("steps = 10", 'source = "photos"', "defaults.source is not a key"),
        ('"spatial"', '"magic"', "job[1].matching is 'magic'; expected 'auto', 'spatial' or 'exhaustive'"),
        ('name = "b"', 'name = "../b"', "job[1].name is '../b'"),
        ('name = "b"\n', "", "job[1].name is missing"),
        ('name = "b"', 'name = "A"', "the name 'a' comes twice"),
        ('out = "deep/b"', 'out = "a"', "jobs 'a' and 'b' share the out"),
        ('out = "deep/b"', 'out = "a/inside"', "jobs 'a' and 'b' share the out"),
        ('out = "deep/b"', 'out = "../batch"', "job 'b': out is"),
        ('out = "deep/b"', 'out = "jobs/b"', "job 'b': out is"),
        ('out = "deep/b"', 'out = ""', "job[1].out is ''; string should have at least 1 character"),
        ('"photos"\nout', '"nowhere"\nout', "job 'b': "),
        ('"fleet.toml"', '"none.toml"', "none.toml is no file"),
        ("steps = 20", 'set = ["train.sky=7"]', "job 'b': --set 'train.sky=7': input should be a valid boolean"),
        ("steps = 20", 'set = ["train.num_steps=7"]', "job 'b': --set train.num_steps is given twice"),
        ("steps = 20", 'emulate = "fleet.toml"', "job 'b': --system and --emulate both name a system"),
        ("[[job]]", "[job]", "not a TOML file"),
    ],
)
def test_a_bad_value_gets_one_sentence_with_file_and_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TWO
    with pytest.raises(BadInput) as caught:
        jobs_of(tmp_path, TWO.replace(old, new, 1))
    assert str(caught.value).startswith(f"{tmp_path / 'night.toml'}: ")
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "batch").exists()


@pytest.mark.parametrize("text", ["", "job = []", "job = 3", "[defaults]\nsteps = 1"])
def test_a_file_without_jobs_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(BadInput, match="job is"):
        jobs_of(tmp_path, text)
