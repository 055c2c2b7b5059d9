"""What is measured: the sections of the benchmark and their contestants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from benchmarks.builds import Build
from benchmarks.measure_vectorisation import VECTORISATIONS
from benchmarks.rounds import Contestant

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
ON_OUR_ENGINE = ", on fbrl's engine"
TRAINING_MEMORY, STORED_FRAME = "fbrl-train, 8 matches, CNN", "stored frame"


@dataclass(frozen=True)
class Scale:
    """How much is measured.

    Attributes:
        seconds: Of stepping, in each measurement of a rate.
        scenarios: Of the sections on the engine and the environment.
        training_scenarios: Of the section on training.
        num_envs: Numbers of matches of the section on vectorisation.
        cnn_steps: Steps of each match in a batch of the CNN.
        mlp_steps: Likewise, of the MLP.
        iterations: Of a training, the first of which is left out.
        memory_arguments: Of the ``fbrl-train`` whose memory is measured.
        device: Of the networks.
    """

    seconds: float
    scenarios: tuple[str, ...]
    training_scenarios: tuple[str, ...]
    num_envs: tuple[int, ...]
    cnn_steps: int
    mlp_steps: int
    iterations: int
    memory_arguments: tuple[str, ...]
    device: str = "auto"


FULL = Scale(
    seconds=2.0,
    scenarios=(THREE_VS_ONE, COUNTERATTACK, FULL_MATCH),
    training_scenarios=(THREE_VS_ONE, COUNTERATTACK),
    num_envs=(1, 2, 4, 8, 16),
    cnn_steps=64,
    mlp_steps=128,
    iterations=2,
    # One whole batch and its updates, and an evaluation, for which there are more matches.
    memory_arguments=("--preset", "thesis", "--total-frames", "4096", "--eval-episodes", "8"),
)

_TINY_TRAINING = "--total-frames 64 --num-steps 8 --minibatch-size 32 --eval-episodes 0"
QUICK = Scale(
    seconds=0.2,
    scenarios=(THREE_VS_ONE,),
    training_scenarios=(THREE_VS_ONE,),
    num_envs=(1, 2),
    cnn_steps=2,
    mlp_steps=4,
    iterations=2,
    memory_arguments=("--preset", "thesis", *_TINY_TRAINING.split()),
)


def _engine(scale: Scale) -> list[Contestant]:
    contestants = []
    for scenario in scale.scenarios:
        bare = {"scenario": scenario, "seconds": scale.seconds}
        function = "benchmarks.measure_engine:bare_engine"
        contestants += [
            Contestant(scenario, ENGINE, function, bare),
            Contestant(
                scenario,
                COLLECTION,
                "benchmarks.measure_training:fbrl_collection",
                {**bare, "num_envs": 8},
            ),
            Contestant(
                scenario, ENGINE_BY_DEFAULT, function, bare, Build.DEFAULT, first_round_only=True
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
    contestants = []
    for scenario in scale.scenarios:
        common = {"scenario": scenario, "seconds": scale.seconds}
        for name, function, build, arguments in _ENVIRONMENTS:
            contestants.append(
                Contestant(
                    scenario,
                    name,
                    f"benchmarks.measure_environment:{function}",
                    {**common, **arguments},
                    build,
                    single_core=True,
                    first_round_only=name.endswith(ON_OUR_ENGINE),
                )
            )
    return contestants


def _vectorisation(scale: Scale) -> list[Contestant]:
    return [
        Contestant(
            str(num_envs),
            vectorisation,
            "benchmarks.measure_vectorisation:collect",
            {
                "scenario": THREE_VS_ONE,
                "vectorisation": vectorisation,
                "num_envs": num_envs,
                "seconds": scale.seconds,
            },
        )
        for num_envs in scale.num_envs
        for vectorisation in VECTORISATIONS
    ]


def _many_cores(scale: Scale) -> list[Contestant]:
    function = "benchmarks.measure_many_cores:share_of_sleeping_engines"
    return [
        Contestant(
            case,
            FBRL,
            function,
            {
                "cores": cores,
                "network": network,
                "matches_per_core": 4,
                "seconds": scale.seconds,
            },
        )
        for case, cores, network in MANY_CORES
    ]


def _training_arguments(scale: Scale, scenario: str, network: str) -> dict[str, object]:
    return {
        "scenario": scenario,
        "network": network,
        "num_steps": scale.cnn_steps if network == "cnn" else scale.mlp_steps,
        "iterations": scale.iterations,
        "device": scale.device,
    }


def training_case(scenario: str, network: str) -> str:
    """The name of a case of the section on training."""
    return f"{scenario}, {network.upper()}"


def _training(scale: Scale) -> list[Contestant]:
    contestants = []
    peer = "benchmarks.measure_training:stable_baselines3_training"
    for scenario in scale.training_scenarios:
        for network in ("mlp", "cnn"):
            case = training_case(scenario, network)
            arguments = _training_arguments(scale, scenario, network)
            contestants += [
                Contestant(case, FBRL, "benchmarks.measure_training:fbrl_training", arguments),
                Contestant(case, PEER, peer, arguments, Build.DEFAULT),
                Contestant(case, PEER + ON_OUR_ENGINE, peer, arguments, first_round_only=True),
            ]
    return contestants


def _time_shares(scale: Scale) -> list[Contestant]:
    return [
        Contestant(
            training_case(THREE_VS_ONE, network),
            FBRL,
            "benchmarks.measure_time_shares:time_shares",
            _training_arguments(scale, THREE_VS_ONE, network),
        )
        for network in ("mlp", "cnn")
    ]


def _memory(scale: Scale) -> list[Contestant]:
    scenario = {"scenario": THREE_VS_ONE}
    return [
        Contestant(
            THREE_VS_ONE,
            TRAINING_MEMORY,
            "benchmarks.measure_memory:peak_of_training",
            {**scenario, "arguments": [*scale.memory_arguments, "--device", scale.device]},
        ),
        Contestant(THREE_VS_ONE, STORED_FRAME, "benchmarks.measure_memory:stored_frame", scenario),
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
