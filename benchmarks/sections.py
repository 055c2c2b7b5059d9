"""What is measured: the sections of the benchmark and their contestants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from benchmarks.measure_collection import VECTORISATIONS
from benchmarks.rounds import Build, Contestant

THREE_VS_ONE = "academy_3_vs_1_with_keeper"
COUNTERATTACK = "academy_counterattack_hard"
FULL_MATCH = "11_vs_11_easy_stochastic"

FRAMES, STEPS, RESETS = "frames_per_second", "steps_per_second", "resets_per_second"
"""Names of the rates; frames are steps with the resets of matches in their time."""

SHARE = "share"

MANY_CORES = [
    (f"{cores} cores, {'MLP' if network == 'mlp' else 'as if on a GPU'}", cores, network)
    for network in ("mlp", "gpu")
    for cores in (16, 64)
]
"""Case, number of cores and network of the section on many cores."""

ENGINE, ENGINE_BY_DEFAULT = "bare engine", "bare engine, default build"
COLLECTION = "fbrl collection, MLP"
MINIMAP, SIMPLE115 = "fbrl FootballEnv, mini map keys", "fbrl FootballEnv, simple115"
TRAINING_ENV = "fbrl make_env, 8 matches, stacked mini maps"
PIXELS = "fbrl FootballEnv, pixels"
SMM, SIMPLE115V2 = "gfootball, SMM", "gfootball, simple115v2"
STACKED_SMM = "gfootball, stacked SMM"
FBRL, PEER = "fbrl", "Stable-Baselines3"
IN_BFLOAT16, ON_OUR_ENGINE = ", in bfloat16", ", on fbrl's engine"
TRAINING_MEMORY, STORED_FRAME = "fbrl-train, 8 matches, CNN", "stored frame"


@dataclass(frozen=True)
class Scale:
    """How much is measured."""

    seconds: float
    """Of stepping, in each measurement of a rate."""
    scenarios: tuple[str, ...]
    """Of the sections on the engine and the environment; training leaves out the full match."""
    num_envs: tuple[int, ...]
    """Numbers of matches of the section on vectorisation."""
    cnn_steps: int
    """Steps of each match in a batch."""
    mlp_steps: int
    memory_arguments: tuple[str, ...]
    """Of the ``fbrl-train`` whose memory is measured."""
    device: str = "auto"


FULL = Scale(
    seconds=2.0,
    scenarios=(THREE_VS_ONE, COUNTERATTACK, FULL_MATCH),
    num_envs=(1, 2, 4, 8, 16),
    cnn_steps=64,
    mlp_steps=128,
    # One whole batch and its updates, and an evaluation, for which there are more matches.
    memory_arguments=("--preset", "thesis", "--total-frames", "4096", "--eval-episodes", "8"),
)

_TINY_TRAINING = "--total-frames 64 --num-steps 8 --minibatch-size 32 --eval-episodes 0"
QUICK = Scale(
    seconds=0.2,
    scenarios=(THREE_VS_ONE,),
    num_envs=(1, 2),
    cnn_steps=2,
    mlp_steps=4,
    memory_arguments=("--preset", "thesis", *_TINY_TRAINING.split()),
)


def _engine(scale: Scale) -> list[Contestant]:
    contestants = []
    for scenario in scale.scenarios:
        bare = {"scenario": scenario, "seconds": scale.seconds}
        engine = "benchmarks.measure_engine:bare_engine"
        collection = "benchmarks.measure_collection:fbrl_collection"
        contestants += [
            Contestant(scenario, ENGINE, engine, bare),
            Contestant(scenario, COLLECTION, collection, {**bare, "num_envs": 8}),
            Contestant(
                scenario, ENGINE_BY_DEFAULT, engine, bare, Build.DEFAULT, first_round_only=True
            ),
        ]
    return contestants


_SMM: dict[str, object] = {"representation": "extracted"}
_SIMPLE115V2: dict[str, object] = {"representation": "simple115v2"}
_ENVIRONMENTS: list[tuple[str, str, Build, dict[str, object]]] = [
    (MINIMAP, "fbrl_env", Build.FBRL, {"observation": "minimap"}),
    (SMM, "gfootball_env", Build.DEFAULT, _SMM),
    (SIMPLE115, "fbrl_env", Build.FBRL, {"observation": "simple115"}),
    (SIMPLE115V2, "gfootball_env", Build.DEFAULT, _SIMPLE115V2),
    (PIXELS, "fbrl_env", Build.FBRL, {"observation": "pixels"}),
    (TRAINING_ENV, "fbrl_training_env", Build.FBRL, {"observation": "minimap", "num_envs": 8}),
    (STACKED_SMM, "gfootball_env", Build.DEFAULT, {**_SMM, "stacked": True}),
    (SMM + ON_OUR_ENGINE, "gfootball_env", Build.FBRL, _SMM),
    (SIMPLE115V2 + ON_OUR_ENGINE, "gfootball_env", Build.FBRL, _SIMPLE115V2),
]


def _environment(scale: Scale) -> list[Contestant]:
    return [
        Contestant(
            scenario,
            name,
            f"benchmarks.measure_environment:{function}",
            {"scenario": scenario, "seconds": scale.seconds, **arguments},
            build,
            single_core=True,
            first_round_only=name.endswith(ON_OUR_ENGINE),
        )
        for scenario in scale.scenarios
        for name, function, build, arguments in _ENVIRONMENTS
    ]


def _vectorisation(scale: Scale) -> list[Contestant]:
    function = "benchmarks.measure_collection:collect"
    common = {"scenario": THREE_VS_ONE, "seconds": scale.seconds}
    return [
        Contestant(str(n), name, function, {**common, "vectorisation": name, "num_envs": n})
        for n in scale.num_envs
        for name in VECTORISATIONS
    ]


def _many_cores(scale: Scale) -> list[Contestant]:
    function = "benchmarks.measure_collection:share_of_sleeping_engines"
    common = {"matches_per_core": 4, "seconds": scale.seconds}
    return [
        Contestant(case, FBRL, function, {**common, "cores": cores, "network": network})
        for case, cores, network in MANY_CORES
    ]


def _training_arguments(scale: Scale, scenario: str, network: str) -> dict[str, object]:
    return {
        "scenario": scenario,
        "network": network,
        "num_steps": scale.cnn_steps if network == "cnn" else scale.mlp_steps,
        "iterations": 2,  # the first is left out
        "device": scale.device,
    }


def training_case(scenario: str, network: str) -> str:
    """The name of a case of the section on training."""
    return f"{scenario}, {network.upper()}"


def _training(scale: Scale) -> list[Contestant]:
    contestants = []
    ours = "benchmarks.measure_training:fbrl_training"
    peer = "benchmarks.measure_training:stable_baselines3_training"
    for scenario in scale.scenarios:
        if scenario == FULL_MATCH:
            continue
        for network in ("mlp", "cnn"):
            case = training_case(scenario, network)
            arguments = _training_arguments(scale, scenario, network)
            contestants += [
                Contestant(case, FBRL, ours, arguments),
                Contestant(case, PEER, peer, arguments, Build.DEFAULT),
                Contestant(case, PEER + ON_OUR_ENGINE, peer, arguments, first_round_only=True),
            ]
            if network == "cnn":
                mixed = {**arguments, "precision": "bfloat16"}
                contestants.append(Contestant(case, FBRL + IN_BFLOAT16, ours, mixed))
    return contestants


def _time_shares(scale: Scale) -> list[Contestant]:
    function = "benchmarks.measure_time_shares:time_shares"
    return [
        Contestant(
            training_case(THREE_VS_ONE, network),
            FBRL,
            function,
            _training_arguments(scale, THREE_VS_ONE, network),
        )
        for network in ("mlp", "cnn")
    ]


def _memory(scale: Scale) -> list[Contestant]:
    scenario = {"scenario": THREE_VS_ONE}
    arguments = [*scale.memory_arguments, "--device", scale.device]
    training = {**scenario, "arguments": arguments}
    mixed = {**scenario, "arguments": [*arguments, "--network.precision", "bfloat16"]}
    module = "benchmarks.measure_memory"
    peak, in_bfloat16 = f"{module}:peak_of_training", TRAINING_MEMORY + IN_BFLOAT16
    return [
        Contestant(THREE_VS_ONE, TRAINING_MEMORY, peak, training),
        Contestant(THREE_VS_ONE, in_bfloat16, peak, mixed),
        Contestant(THREE_VS_ONE, STORED_FRAME, f"{module}:stored_frame", scenario),
    ]


SECTIONS: Mapping[str, Callable[[Scale], list[Contestant]]] = {
    "engine": _engine,
    "environment": _environment,
    "vectorisation": _vectorisation,
    "many_cores": _many_cores,
    "training": _training,
    "time_shares": _time_shares,
    "memory": _memory,
}
"""The contestants of each section, in the order in which they take turns."""

MEASURED_ONCE = ("memory",)
"""Sections whose figures hardly vary: they are not repeated."""
