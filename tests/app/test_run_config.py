"""The configuration of a run: options, a run file and `--set` make the same one, and what cannot be used is refused in one sentence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import radiant_app.cli.run
from radiant_app.cli.app import app
from radiant_app.commands.run.pipeline import run
from radiant_app.config.fields import config_of, tables_of, train_options, values_of, with_settings
from radiant_app.config.run_config import AggregateOptions, ExecutionOptions, PlanOptions, RunConfig, SfmOptions, TrainOptions
from radiant_core.aggregate.config import Refine
from radiant_core.errors import BadInput
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import Mcmc
from radiant_core.train.needs import Overrides, fit_to_backend

FILE = """
source = "photos"
out = "run"
system = "fleet.toml"
seed = 3
preset = "paper"
[plan]
method = "even"
[train]
num_steps = 300
sky = false
max_epochs = "none"
density.kind = "mcmc"
[aggregate]
cloud.epochs = 2
[execution]
checkpoint_every_s = 90
"""
ASKED: dict[str, Any] = {
    "seed": 3,
    "upload": "float32",
    "sfm": SfmOptions(matching="exhaustive", effort="thorough"),
    "plan": PlanOptions(method="even", within_edge="joined", between_edges="joined"),
    "train": TrainOptions(
        preset="paper", num_steps=300, step_policy="fixed", settings={"sky": False, "max_epochs": None, "density.kind": "mcmc"}
    ),
    "aggregate": AggregateOptions(preset="paper", settings={"cloud.epochs": 2}),
    "execution": ExecutionOptions(checkpoint_every_s=90.0),
}


@pytest.fixture
def asked(tmp_path: Path) -> RunConfig:
    return RunConfig(source=tmp_path / "photos", out=tmp_path / "run", system=tmp_path / "fleet.toml", **ASKED)


def started(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> RunConfig:
    """The configuration with which `radiant run` with these arguments would start."""
    configs: list[RunConfig] = []
    monkeypatch.setattr(radiant_app.cli.run, "run_and_print", lambda config, resume, as_json, verbose: configs.append(config))
    result = CliRunner().invoke(app, ["run", *map(str, arguments)])
    if result.exception is not None:
        raise result.exception
    (config,) = configs
    return config


def run_file(folder: Path, text: str = FILE) -> Path:
    path = folder / "night.toml"
    path.write_text(text)
    return path


def test_a_run_file_options_and_set_start_the_same_run(tmp_path: Path, asked: RunConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    assert started(monkeypatch, run_file(tmp_path)) == asked
    where = (tmp_path / "photos", "--out", tmp_path / "run", "--system", tmp_path / "fleet.toml", "--preset", "paper")
    train_set = ("--set=train.sky=false", "--set=train.max-epochs=none", "--set=train.density.kind=mcmc")
    only_set = (*train_set, "--set", "aggregate.cloud.epochs=2")
    options = ("--seed", 3, "--plan-method", "even", "--steps", 300, "--checkpoint-every", "1.5m")
    assert started(monkeypatch, *where, *options, *only_set) == asked
    paths = ("seed=3", "plan.method=even", "train.num_steps=300", "execution.checkpoint_every_s=90")
    assert started(monkeypatch, *where, *only_set, *(f"--set={path}" for path in paths)) == asked


def test_options_beside_a_run_file_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = started(monkeypatch, run_file(tmp_path), "--steps", 7, "--set=plan.method=paper", "--out", tmp_path / "other")
    assert (config.train.num_steps, config.plan.method, config.out) == (7, "paper", tmp_path / "other")
    assert config.train.settings == {"sky": False, "max_epochs": None, "density.kind": "mcmc"}


def test_masks_of_gradients_are_an_option_and_a_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    where = (tmp_path / "photos", "--out", tmp_path / "run")
    assert not started(monkeypatch, *where).plan.mask_gradients
    for asked in ("--mask-gradients", "--set=plan.mask_gradients=true"):
        config = started(monkeypatch, *where, asked)
        assert config.plan.mask_gradients and config_of(values_of(tables_of(config), "job")) == config


def test_a_configuration_comes_back_from_its_tables(asked: RunConfig) -> None:
    for config in (asked, RunConfig(source=asked.source, out=asked.out)):
        assert config_of(values_of(tables_of(config), "job")) == config


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("num_steps = 300", 'num_steps = "300"', "train.num_steps is '300'; expected a valid integer"),
        ("num_steps = 300", "num_steps = 0", "train.num_steps is 0; expected greater than or equal to 1"),
        ("num_steps = 300", "step = 300", "train.step is not a key of a run file"),
        ("sky = false", "sky = 7", "train.sky is 7; expected a valid boolean"),
        ("sky = false", "start_scale = 2", "start_scale is 2.0"),
        ("seed = 3", "num_steps = 3", "num_steps is not a key of a run file: use train.num_steps."),
        ("[plan]", "[plans]", "plans is not a section of a run file: did you mean [plan]?"),
        ("seed = 3", "evaluate = 3", "evaluate is 3, expected a section, [evaluate]."),
        ('"even"', '"magic"', "plan.method is 'magic'; expected 'exact', 'paper', 'paper-literal' or 'even'"),
        ('system = "fleet.toml"', 'system = ""', "system is ''; string should have at least 1 character"),
        ('source = "photos"', "", "source is missing"),
        ("cloud.epochs", "refine_epochs", "aggregate.refine_epochs is not a key of a run file: it is refine.epochs now."),
        ("cloud.epochs", "cloud_epochs", "aggregate.cloud_epochs is not a key of a run file: it is aggregate.cloud.epochs now."),
        ("cloud.epochs = 2", 'cloud = "retrain"', "aggregate.cloud is not a key of a run file: it is aggregate.cloud.method now."),
        ("[train]", "[train", "not a TOML file"),
    ],
)
def test_a_bad_run_file_gets_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, said: str) -> None:
    assert old in FILE
    with pytest.raises(BadInput) as caught:
        started(monkeypatch, run_file(tmp_path, FILE.replace(old, new, 1)))
    assert said in str(caught.value) and "\n" not in str(caught.value) and str(caught.value).count("night.toml") <= 1


def test_values_have_the_type_of_their_field() -> None:
    given = [
        "train.light=none",
        "train.start_scale=1",
        "train.sky=false",
        "train.sh-degree=2",
        "train.budget_s=none",
        "plan.method = even",
    ]
    assert with_settings({}, given) == {
        "train.light": "none", "train.start_scale": 1.0, "train.sky": False, "train.sh_degree": 2, "train.budget_s": None,
        "plan.method": "even",
    }  # fmt: skip


def test_what_is_set_is_a_forced_decision() -> None:
    given = ["train.start_scale=1", "train.adam=visible", "train.density.kind=mcmc", "train.density.every=50"]
    config, decisions = fit_to_backend(train_preset("default"), "gsplat", train_options(with_settings({}, given, "train")).overrides)
    assert (config.start_scale, config.adam, config.density) == (1.0, "visible", Mcmc(every=50))
    assert {decision.topic for decision in decisions if decision.forced} == {"start_scale", "adam", "density.kind", "density.every"}
    assert train_options({"train.num_steps": 5}).overrides == Overrides(num_steps=5)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["aggregate.refine_rounds=2"], r"sets nothing: it is refine\.rounds now\.$"),
        (["aggregate.faint_opacity=0"], r"it is aggregate\.edge\.faint_opacity and aggregate\.cloud\.faint_opacity now\.$"),
        (["aggregate.cloud.method=retrain"], "'fade', 'paper' or 'crop_merge'"),
        (["refine.epoch=2"], r"did you mean refine\.epochs\?"),
        (["train.colour=red"], "expected PATH=VALUE with one of .*train.sh_degree"),
        (["colour=red"], r"expected PATH=VALUE with one of source, .*train\.…"),
        (["light=auto"], r"use train\.light\."),
        (["preset.x=1"], "expected PATH=VALUE"),
        (["train.start_scale"], r"expected train\.start_scale=VALUE"),
        (["train.start_scale=big"], "unable to parse"),
        (["train.adam=sparse"], "'visible' or 'dense'"),
        (["train.sh_degree=none"], "valid integer"),
        (["train.long_side_px=5"], "greater than or equal to 16"),
        (["train.means_lr=nan"], "finite number"),
        (["aggregate.edge.agreement_db=inf"], "finite number"),
        (["train.seed=5"], r"use seed\.|expected PATH=VALUE"),
        (["train.sky=true", "train.sky=false"], "--set train.sky is given twice: keep one"),
        (["train.num_steps=5"], "--set train.num_steps is given twice, once as --steps: keep one"),
    ],
)
def test_what_cannot_be_set_is_refused(given: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said) as refused:
        with_settings({"train.num_steps": 7}, given)
    assert str(refused.value).startswith("--set ")


def test_a_plan_that_is_not_there_is_refused_before_the_run_begins(tmp_path: Path) -> None:
    config = RunConfig(source=tmp_path, out=tmp_path / "run", plan=PlanOptions(file=tmp_path / "plan.json"))
    with pytest.raises(BadInput, match=r"--plan .*plan.json is no file: give the plan.json that `radiant plan` wrote"):
        run(config)
    assert not config.out.exists()


def test_a_training_takes_no_setting_of_a_run(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["train", str(tmp_path), "--out", str(tmp_path / "out"), "--set", "plan.method=even"]).exception
    assert isinstance(refused, BadInput) and "expected PATH=VALUE" in str(refused)


def test_a_value_out_of_range_is_refused_before_the_run_begins() -> None:
    of_no_policy = {"train.density.kind": "mcmc", "train.density.reset_opacity_every": 5}
    for values in ({"train.start_scale": 2.0}, {"aggregate.edge.epochs": 0}, {"refine.rounds": 0}, of_no_policy):
        with pytest.raises(
            BadInput, match=r"start_scale is 2|edge.epochs of joining|rounds of refining is 0|reset_opacity_every is no setting of 'mcmc'"
        ):
            config_of({"source": Path("photos"), "out": Path("run"), **values})


def test_refining_has_a_section_of_its_own_beside_the_preset_of_joining() -> None:
    where = {"source": Path("photos"), "out": Path("run")}
    assert config_of({**where, "refine.rounds": 2}).joining.refine == Refine(rounds=2)
    paper = {**where, "aggregate.preset": "paper"}
    assert not config_of(paper).joining.refine.is_asked_for and config_of({**paper, "refine.epochs": 1}).joining.refine.is_asked_for
    with pytest.raises(BadInput, match="0 epochs at the cloud leave the models to the devices"):
        config_of({**where, "aggregate.cloud.epochs": 0, "refine.epochs": 0})


def test_devices_of_a_run_are_planned_for_one_training_each() -> None:
    with pytest.raises(BadInput, match=r"cross_validate is always, which is for a model that stands alone, by `radiant train`"):
        config_of({"source": Path("photos"), "out": Path("run"), "train.cross_validate": "always"})


def test_a_plan_made_before_capture_and_a_method_exclude_each_other() -> None:
    where: dict[str, Any] = {"source": Path("photos"), "out": Path("run"), "plan.file": Path("plan.json")}
    with pytest.raises(BadInput, match="--plan keeps to a plan"):
        config_of({**where, "plan.method": "even"})
    assert config_of({**where, "preset": "paper"}).plan == PlanOptions(file=Path("plan.json"), within_edge="joined", between_edges="joined")


def test_the_knobs_of_the_papers_algorithm_are_settings_of_its_plan() -> None:
    where: dict[str, Any] = {"source": Path("photos"), "out": Path("run")}
    given = ["plan.boundary_step=0.02", "plan.threshold=0.1"]
    for method in ("paper", "paper-literal"):
        config = config_of(with_settings({**where, "plan.method": method}, given))
        assert config.plan.paper == PaperConfig(boundary_step=0.02, threshold=0.1)
    assert config_of({**where, "preset": "paper"}).plan.paper is None
    with pytest.raises(BadInput, match=r"plan.threshold is for Alg. 1 and the plan's method is exact: use paper or paper-literal"):
        config_of(with_settings(where, ["plan.threshold=0.1"]))
    for wrong in ("plan.threshold=0", "plan.boundary_step=-1", "plan.boundary_step=1.5"):
        with pytest.raises(BadInput, match=r"paper planner: (threshold|boundary_step) is .*, expected a ") as refused:
            config_of(with_settings({**where, "plan.method": "paper"}, [wrong]))
        assert str(refused.value).count(".\n") == 0 and str(refused.value).endswith(".")


def test_the_configuration_imports_nothing_heavy() -> None:
    code = "import sys, radiant_app.config.fields; print([name for name in ('numpy', 'torch', 'scipy', 'cv2') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
