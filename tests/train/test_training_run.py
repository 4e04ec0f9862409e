"""Training runs: what they leave behind, and that going on is the same as never having stopped."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs skincal[train]")

import small_runs

from skincal.envs import MarbleRollEnv
from skincal.errors import InputError
from skincal.files import alone
from skincal.ranges import preset
from skincal.train import Network, Policy, Settings, begin, maker, read_curve, read_policy, read_run, train
from skincal.train.settings import part_seed, rounds_of

JAX = pytest.param(
    "sbx",
    marks=[
        pytest.mark.slow,
        pytest.mark.filterwarnings("ignore::DeprecationWarning"),
        pytest.mark.skipif(find_spec("sbx") is None, reason="needs skincal[sbx]"),
    ],
)


class KilledError(Exception):
    pass


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Policy]:
    """Copies a run of so many checkpoints, which is made once, into a new folder; returns its policy."""
    runs: dict[tuple[int, str], Path] = {}

    def copy(folder: Path, checkpoints: int = 1, backend: str = "sb3") -> Policy:
        if (checkpoints, backend) not in runs:
            runs[checkpoints, backend] = tmp_path_factory.mktemp("runs") / "run"
            steps = checkpoints * small_runs.CHECKPOINT_STEPS
            small_runs.run(runs[checkpoints, backend], steps, backend)
        shutil.copytree(runs[checkpoints, backend], folder)
        return read_policy(folder / "policy.onnx")

    return copy


@pytest.mark.parametrize("change", [{"steps": 10**30}, {"seed": -1}, {"rounds_per_checkpoint": 0}])
def test_a_run_that_could_not_be_read_is_not_begun(tmp_path: Path, change: dict[str, int]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        begin(replace(small_runs.work(), **change), preset("iros24"), tmp_path / "run")
    assert not [*tmp_path.iterdir()]


def last_network(folder: Path) -> list[np.ndarray]:
    """All numbers of the policy file, from the graph itself."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(folder / "policy.onnx").graph
    return [numpy_helper.to_array(value) for value in graph.initializer]


def assert_same_policy(one: Path, other: Path) -> None:
    for a, b in zip(last_network(one), last_network(other), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("backend", ["sb3", "ppo", JAX])
def test_going_on_is_exact(tmp_path, backend, copied):
    copied(tmp_path / "straight", 4, backend)
    copied(tmp_path / "twice", 2, backend)
    small_runs.run(tmp_path / "twice", 4 * small_runs.CHECKPOINT_STEPS, backend)
    assert_same_policy(tmp_path / "straight", tmp_path / "twice")
    one, other = (read_curve(tmp_path / name / "curve.csv") for name in ("straight", "twice"))
    for column in ("steps", "reward", "error_m", "drops"):
        assert np.array_equal(one[column], other[column], equal_nan=True)


@pytest.mark.parametrize("backend", ["sb3", JAX])
def test_a_run_goes_on_from_a_policy(tmp_path, backend, copied):
    """The critics alone learn at first; then the policy does; an interruption changes nothing."""
    first = copied(tmp_path / "first", 1, backend)
    work = replace(small_runs.work(backend), rounds_per_checkpoint=1)
    held = work.settings.learning_starts
    for name, stops in (("straight", (3 * held,)), ("twice", (held, 3 * held))):
        begin(work, preset("iros24"), tmp_path / name, start=first)
        for stop in stops:
            tuned = read_policy(train(tmp_path / name, small_runs.make, stop).policy)
            same = np.array_equal(first.network.weights[0], tuned.network.weights[0])
            assert same == (stop == held)
    assert tuned.description.start == "policy"
    assert_same_policy(tmp_path / "straight", tmp_path / "twice")


@pytest.mark.parametrize("backend", ["sb3", "ppo", JAX])
def test_a_run_goes_on_from_another_run(tmp_path, backend, copied):
    """It begins at step 0 with all that the other has learned and remembers."""
    start = copied(tmp_path / "first", 1, backend)
    begin(small_runs.work(backend), preset("icra26"), tmp_path / "tuned", start=start, run=tmp_path / "first")
    (weights,) = (tmp_path / "first/checkpoint").glob("weights.*")
    assert (tmp_path / "tuned/checkpoint" / weights.name).read_bytes() == weights.read_bytes()
    before, after = (np.load(tmp_path / name / "checkpoint/arrays.npz") for name in ("first", "tuned"))
    assert before["counters"][0] == small_runs.CHECKPOINT_STEPS
    assert not after["counters"].any()
    assert all(np.array_equal(before[name], after[name]) for name in before if name != "counters")
    tuned = train(tmp_path / "tuned", small_runs.make, small_runs.CHECKPOINT_STEPS)
    assert tuned.description.steps == small_runs.CHECKPOINT_STEPS
    assert tuned.description.start == "first"


def test_a_run_without_a_checkpoint_is_no_start(tmp_path, copied):
    first = copied(tmp_path / "first")
    (tmp_path / "first/checkpoint/arrays.npz").unlink()
    with pytest.raises(InputError, match="a whole checkpoint of a run"):
        begin(
            small_runs.work(), preset("iros24"), tmp_path / "tuned",
            start=first, run=tmp_path / "first",
        )  # fmt: skip
    assert not (tmp_path / "tuned").exists()


def test_a_run_does_not_go_on_from_another_kind_of_policy(tmp_path, copied):
    first = copied(tmp_path / "first")
    work = replace(small_runs.work(), settings=Settings())
    with pytest.raises(InputError, match=r"with layers of \(256, 256\); got .* with layers of \(16, 16\)"):
        begin(work, preset("iros24"), tmp_path / "tuned", start=first)
    assert not (tmp_path / "tuned").exists()


@pytest.mark.slow
def test_going_on_is_exact_in_the_real_environment(tmp_path):
    """Physics begins anew with every episode, so nothing of an earlier one is missed."""
    work = replace(
        small_runs.work(), settings=replace(small_runs.SMALL, learning_starts=40), rounds_per_checkpoint=3
    )
    rounds = work.settings.steps_per_round
    for name, stops in (("straight", (12,)), ("twice", (6, 12))):
        begin(work, preset("iros24"), tmp_path / name)
        for stop in stops:
            train(tmp_path / name, maker(work, preset("iros24")), stop * rounds)
    assert_same_policy(tmp_path / "straight", tmp_path / "twice")


@pytest.mark.slow
def test_processes_change_nothing(tmp_path):
    for name, processes in (("one", False), ("many", True)):
        begin(small_runs.work(), preset("iros24"), tmp_path / name)
        train(tmp_path / name, small_runs.make, small_runs.CHECKPOINT_STEPS, processes=processes)
    assert_same_policy(tmp_path / "one", tmp_path / "many")


def test_a_run_that_was_killed_goes_on_exactly(tmp_path, copied):
    copied(tmp_path / "straight", 4)
    folder = tmp_path / "killed"
    copied(folder, 2)

    def kill(row: object) -> None:
        raise KilledError

    with pytest.raises(KilledError):
        train(folder, small_runs.make, progress=kill)
    assert read_curve(folder / "curve.csv")["steps"][-1] > 2 * small_runs.CHECKPOINT_STEPS
    small_runs.run(folder, 4 * small_runs.CHECKPOINT_STEPS)
    assert_same_policy(tmp_path / "straight", folder)
    steps = read_curve(folder / "curve.csv")["steps"]
    assert np.array_equal(steps, np.arange(1, len(steps) + 1) * small_runs.SMALL.steps_per_round)


def test_seeds_matter_and_repeat(tmp_path, copied):
    copied(tmp_path / "a")
    for name, seed in (("b", 3), ("c", 2)):
        small_runs.run(tmp_path / name, small_runs.CHECKPOINT_STEPS, seed=seed)
    a, b, c = (np.concatenate([x.ravel() for x in last_network(tmp_path / n)]) for n in "abc")
    assert np.array_equal(a, b)
    assert not np.allclose(a, c)
    assert part_seed(1, 0) not in {part_seed(1, 1), part_seed(2, 0)}


@pytest.mark.parametrize("backend", ["sb3", "ppo", JAX])
def test_the_file_says_what_the_learner_does(tmp_path, backend, copied):
    """The policy file, the network as bare numbers, and the learner itself act the same."""
    from skincal.train.checkpoint import load_checkpoint
    from skincal.train.training_run import _learner

    policy = copied(tmp_path / "run", 2, backend)
    work, _ = read_run(tmp_path / "run")
    with _learner(work, small_runs.make, processes=False) as learner:
        load_checkpoint(learner, tmp_path / "run" / "checkpoint")
        network = learner.network()
        observation = {"policy": 2.0 * np.random.default_rng(1).normal(size=(40, 10)).astype(np.float32),
                       "critic": np.zeros((40, 4), np.float32)}  # fmt: skip
        observation["policy"][0] = 1e6  # is clipped
        normalised = learner.normalised.normalize_obs(observation)
        expected, _ = learner.model.predict(normalised, deterministic=True)
    np.testing.assert_allclose(network(observation["policy"]), expected, atol=2e-6)
    np.testing.assert_allclose(policy(observation["policy"]), expected, atol=2e-6)
    np.testing.assert_allclose(policy(observation["policy"][3]), expected[3], atol=2e-6)


@pytest.mark.parametrize("backend", ["sb3", JAX])
def test_the_actor_does_not_see_what_the_critics_see(backend):
    from skincal.train.training_run import _learner

    with _learner(small_runs.work(backend), small_runs.make, processes=False) as learner:
        seen = np.random.default_rng(1).normal(size=(1, 10)).astype(np.float32)
        acts = [
            learner.model.predict(
                {"policy": seen, "critic": np.full((1, 4), x, np.float32)}, deterministic=True
            )[0]
            for x in (0.0, 5.0)
        ]
        assert np.array_equal(*acts)
        assert learner.network().observations == 10


def test_the_critics_see_everything():
    from skincal.train.training_run import _learner

    with _learner(small_runs.work(), small_runs.make, processes=False) as learner:
        assert learner.model.critic.qf0[0].in_features == 10 + 4 + 2


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["sb3", JAX])
def test_it_learns(tmp_path, backend):
    """The toy task is learned with the published rates: the error falls to a third of what chance gives."""
    settings = Settings(learning_starts=960, target_entropy=-2.0)
    begin(replace(small_runs.work(backend), settings=settings), preset("iros24"), tmp_path / "run")
    train(tmp_path / "run", small_runs.make, 10 * settings.steps_per_round)
    error = read_curve(tmp_path / "run" / "curve.csv")["error_m"]
    assert error[-1] < error[0] / 3


def test_published_settings():
    settings = Settings()
    assert settings.steps_per_round == 480
    assert rounds_of(settings, 800_000) == 1667
    assert rounds_of(settings, 480) == 1


def test_work_survives_a_file(tmp_path, copied):
    copied(tmp_path / "run")
    # What was not given is written down as well.
    environment = MarbleRollEnv.default_options().numbers
    assert read_run(tmp_path / "run")[0] == replace(small_runs.work(), environment=environment)
    assert environment["solver_iterations"] == 20 and "rewards" not in environment


def test_a_damaged_checkpoint(tmp_path, copied):
    copied(tmp_path / "run")
    (tmp_path / "run" / "checkpoint" / "weights.pt").write_bytes(b"no weights")
    with pytest.raises(
        InputError, match=r"checkpoint: expected a whole checkpoint of this run; got .*remove"
    ):
        small_runs.run(tmp_path / "run", 2 * small_runs.CHECKPOINT_STEPS)


def test_two_processes_at_one_run(tmp_path, copied):
    folder = tmp_path / "run"
    copied(folder)
    before = (folder / "policy.onnx").read_bytes()
    with alone(folder / "run.toml", folder):
        with pytest.raises(InputError, match="another process at work"):
            small_runs.run(folder, 2 * small_runs.CHECKPOINT_STEPS)
        with pytest.raises(InputError, match="another process at work"):
            begin(small_runs.work(seed=9), preset("iros24"), folder, force=True)
    assert (folder / "policy.onnx").read_bytes() == before


def test_a_run_is_replaced_by_force_and_strangers_in_it_are_not(tmp_path, copied):
    folder = tmp_path / "run"
    copied(folder)
    for listed in (True, False):
        if not listed:
            (folder / ".skincal.json").unlink()
        (folder / "checkpoint" / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match=r"also checkpoint/notes\.txt"):
            begin(small_runs.work(seed=9), preset("iros24"), folder, force=True)
        (folder / "checkpoint" / "notes.txt").unlink()
    begin(small_runs.work(seed=9), preset("iros24"), folder, force=True)
    assert sorted(path.name for path in folder.iterdir()) == [".skincal.json", "ranges.toml", "run.toml"]


def test_a_checkpoint_that_was_moved_away_comes_back(tmp_path, copied):
    """The state after a kill where the file system cannot exchange two names."""
    folder = tmp_path / "run"
    copied(folder, 2)
    (folder / "checkpoint").rename(folder / ".checkpoint.abcd_123.old")
    (folder / ".policy.onnx.abcd_123.part").mkdir()
    small_runs.run(folder, 4 * small_runs.CHECKPOINT_STEPS)
    copied(tmp_path / "straight", 4)
    ends = [read_curve(tmp_path / name / "curve.csv")["reward"] for name in ("run", "straight")]
    np.testing.assert_array_equal(*ends)
    assert not [path.name for path in folder.iterdir() if path.suffix in (".old", ".part")]


def test_network_shapes():
    network = Network.build(
        [1.0, 2.0], [4.0, 1.0], 10.0, [(np.ones((2, 3)), np.zeros(3)), (np.ones((3, 1)), [0.5])]
    )
    assert (network.observations, network.actions) == (2, 1)
    assert network([[3.0, 2.0]])[0, 0] == pytest.approx(np.tanh(3 * 1.0 + 0.5))
    assert network([[-9.0, 2.0]])[0, 0] == pytest.approx(np.tanh(0.5))  # what bends is bent
