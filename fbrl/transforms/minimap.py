"""The Super Mini Map of Google Research Football, compact and dense.

A frame marks up to 24 cells of a grid of 72 rows and 96 columns: 11 left players, 11 right
players, the ball, and the active player. Dense, four stacked frames are 110,592 bytes of which at
most 96 are not zero. :class:`MiniMapCells` keeps the 96 cell indices (192 bytes) and
:func:`cells_to_planes` draws them where they are needed, for example on the GPU, inside a network.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Bounded, Composite
from torchrl.envs import Transform

from fbrl.checks.counts import check_count
from fbrl.transforms.minimap_grid import (
    ABSENT,
    CELLS_PER_FRAME,
    NUM_CELLS,
    SMM_HEIGHT,
    SMM_LAYERS,
    SMM_WIDTH,
    cells_to_planes,
    frame_cells,
)
from fbrl.transforms.raw_observation import read_fields

__all__ = ["MiniMapCells", "SuperMiniMap", "cells_to_planes"]

_FIELDS = ("left_team", "right_team", "ball", "active", "left_team_roles", "right_team_roles")


class MiniMapCells(Transform):
    """Super Mini Map as cell indices, stacked over the latest frames.

    Writes ``minimap_cells``, an int16 tensor of shape ``(*batch, num_frames, 24)``, oldest frame
    first. A frame holds the cells of 11 left players, 11 right players, the ball and the active
    player; a cell is ``row * 96 + column`` of gfootball's ``generate_smm``, and -1 marks a player
    who isn't there (roles of -1, or no active player). A reset fills the stack with the first
    frame.

    The stack of the previous step is read from the tensordict, not kept in the module: partial
    resets, batched environments and resuming from a stored tensordict need nothing else.

    As a replay buffer transform, or called on a stored trajectory, it computes the cells from the
    raw observations where the batch has none yet. The last batch dimension must then be named
    ``"time"``, and a trajectory cut in the middle of an episode starts as if after a reset.

    Args:
        num_frames: how many frames are stacked.
        in_keys: where to find ``left_team``, ``right_team``, ``ball``, ``active``,
            ``left_team_roles`` and ``right_team_roles``, in this order.
        out_keys: where to write the cells.

    Raises:
        ValueError: if there are fewer frames than one, or more or fewer keys than these.
        TypeError: if ``num_frames`` is no integer.

    Who is at a NaN position is left out, as one who isn't there; an ``active`` that is no index of
    the left team is an error on a CPU.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> match = TensorDict(
        ...     left_team=torch.zeros(1, 11, 2),
        ...     right_team=torch.full((1, 11, 2), -1.0),
        ...     ball=torch.tensor([[1.0, 0.42, 0.1]]),
        ...     active=torch.tensor([3]),
        ...     left_team_roles=torch.arange(11).clamp(max=9)[None],
        ...     right_team_roles=torch.full((1, 11), -1),
        ...     batch_size=[1],
        ... ).unsqueeze(-1).refine_names(..., "time")
        >>> cells = MiniMapCells()(match)["minimap_cells"]
        >>> cells.shape, cells.dtype
        (torch.Size([1, 1, 4, 24]), torch.int16)
        >>> centre, no_player, ball, active = cells[0, 0, -1, [0, 11, 22, 23]].tolist()
        >>> centre == active == 36 * 96 + 48, no_player, divmod(ball, 96)
        (True, -1, (70, 95))
    """

    def __init__(
        self,
        num_frames: int = 4,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        num_frames = check_count("num_frames", num_frames)
        super().__init__(
            in_keys=list(_FIELDS) if in_keys is None else in_keys,
            out_keys=self._default_out_keys() if out_keys is None else out_keys,
        )
        if len(self.in_keys) != len(_FIELDS) or len(self.out_keys) != len(self._default_out_keys()):
            raise ValueError(
                f"{type(self).__name__}: in_keys must name {len(_FIELDS)} keys for {_FIELDS}, and "
                f"out_keys {len(self._default_out_keys())} for {self._default_out_keys()}, in this "
                f"order; got in_keys={self.in_keys} and out_keys={self.out_keys}."
            )
        self.num_frames = num_frames

    @staticmethod
    def _default_out_keys() -> list[str]:
        return ["minimap_cells"]

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        stack = tensordict.get(self.out_keys[0], None)
        if stack is None:
            raise KeyError(
                f"{type(self).__name__}: the previous frames, {self.out_keys[0]!r}, are missing "
                f"from the tensordict given to step(). Pass on what reset() returned, or what "
                f"step_mdp() made of the last step, with the action added."
            )
        if stack.dtype != torch.int16 or stack.shape[-2:] != (self.num_frames, CELLS_PER_FRAME):
            raise ValueError(
                f"{type(self).__name__}: {self.out_keys[0]!r} of the step before is {stack.dtype} "
                f"of shape {tuple(stack.shape)}, but must be torch.int16 of shape (*batch, "
                f"{self.num_frames}, {CELLS_PER_FRAME})."
            )
        self._write(next_tensordict, _push(stack, self._frame(next_tensordict)))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        stack = _fill(self._frame(tensordict_reset), self.num_frames)
        reset = tensordict.get("_reset", None)
        previous = tensordict.get(self.out_keys[0], None)
        if reset is not None and previous is not None:
            stack = torch.where(reset.unsqueeze(-1), stack, previous)
        self._write(tensordict_reset, stack)
        return tensordict_reset

    _reset_on_native_autoreset = _reset

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes the cells of a stored trajectory, unless the batch already has them."""
        if tensordict.get(self.out_keys[0], None) is None:
            self._stack_trajectory(tensordict)
        return tensordict

    def _frame(self, tensordict: TensorDictBase) -> torch.Tensor:
        return frame_cells(*read_fields(tensordict, self.in_keys, _FIELDS, type(self).__name__))

    def _write(self, tensordict: TensorDictBase, cells: torch.Tensor) -> None:
        tensordict.set(self.out_keys[0], cells)

    def _stack_trajectory(self, trajectory: TensorDictBase) -> None:
        names = trajectory.names
        if not names or names[-1] != "time":
            raise ValueError(
                f"{type(self).__name__}: the frames of a batch can only be stacked along time, but "
                f"its dimensions are named {names}. Collect {self.out_keys[0]!r} in the "
                f"environment, or call refine_names(..., 'time') on a batch whose last dimension "
                f"is time."
            )
        frames = self._frame(trajectory)
        done = trajectory.get(("next", "done"), None)
        cells = _stack_history(frames, done, self.num_frames)
        self._write(trajectory, cells)
        if ("next", self.in_keys[0]) in trajectory.keys(include_nested=True):
            following = trajectory.get("next")
            self._write(following, _push(cells, self._frame(following)))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the cells to the observation."""
        observation_spec[self.out_keys[0]] = self._cells_spec(observation_spec)
        return observation_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Adds the cells to the state: each step reads those of the step before."""
        input_spec["full_state_spec", self.out_keys[0]] = self._cells_spec(
            input_spec["full_state_spec"]
        )
        return input_spec

    def _cells_spec(self, parent: Composite) -> Bounded:
        return Bounded(
            ABSENT,
            NUM_CELLS - 1,
            shape=(*parent.shape, self.num_frames, CELLS_PER_FRAME),
            dtype=torch.int16,
            device=parent.device,
        )


class SuperMiniMap(MiniMapCells):
    """Super Mini Map as dense planes, stacked over the latest frames.

    Writes ``smm``, a uint8 tensor of shape ``(*batch, num_frames * 4, 72, 96)`` with 255 at the
    marked cells. Channel ``4 * frame + layer`` holds one of the layers left team, right team, ball
    and active player; the oldest frame comes first. It equals gfootball's ``SMMWrapper`` under
    ``FrameStack`` after moving the channels to the front. ``minimap_cells``, from which the planes
    are drawn, is written too: see :class:`MiniMapCells`.

    Dense planes take 576 times the memory of the cells. In a replay buffer that stores
    ``minimap_cells`` this transform draws the planes of what is sampled.

    Args:
        num_frames: how many frames are stacked.
        in_keys: as in :class:`MiniMapCells`.
        out_keys: where to write the cells and the planes, in this order.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> cells = torch.full((5, 4, 24), -1, dtype=torch.int16)
        >>> cells[:, :, 22] = 36 * 96 + 48
        >>> batch = SuperMiniMap()(TensorDict(minimap_cells=cells, batch_size=[5]))
        >>> batch["smm"].shape, batch["smm"].dtype
        (torch.Size([5, 16, 72, 96]), torch.uint8)
        >>> batch["smm"][0].nonzero().tolist()
        [[2, 36, 48], [6, 36, 48], [10, 36, 48], [14, 36, 48]]
    """

    @staticmethod
    def _default_out_keys() -> list[str]:
        return ["minimap_cells", "smm"]

    def _write(self, tensordict: TensorDictBase, cells: torch.Tensor) -> None:
        super()._write(tensordict, cells)
        tensordict.set(self.out_keys[1], cells_to_planes(cells))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draws the planes of stored cells, computing the cells first where there are none."""
        cells = tensordict.get(self.out_keys[0], None)
        if cells is None:
            self._stack_trajectory(tensordict)
            return tensordict
        self._write(tensordict, cells)
        following = tensordict.get("next", None)
        if following is not None and following.get(self.out_keys[0], None) is not None:
            self._write(following, following.get(self.out_keys[0]))
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the cells and the planes to the observation."""
        observation_spec = super().transform_observation_spec(observation_spec)
        channels = self.num_frames * len(SMM_LAYERS)
        observation_spec[self.out_keys[1]] = Bounded(
            0,
            255,
            shape=(*observation_spec.shape, channels, SMM_HEIGHT, SMM_WIDTH),
            dtype=torch.uint8,
            device=observation_spec.device,
        )
        return observation_spec


def _push(stack: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
    return torch.cat([stack[..., 1:, :], frame.unsqueeze(-2)], -2)


def _fill(frame: torch.Tensor, num_frames: int) -> torch.Tensor:
    return frame.unsqueeze(-2).repeat_interleave(num_frames, -2)


def _stack_history(
    frames: torch.Tensor, done: torch.Tensor | None, num_frames: int
) -> torch.Tensor:
    """Stacks the frames of a trajectory, without reaching into an older episode."""
    batch = frames.shape[:-1]
    time = torch.arange(batch[-1], device=frames.device)
    episode_start = time.new_zeros(batch)
    if done is not None:
        ended = done.reshape(batch)[..., :-1]
        episode_start[..., 1:] = torch.where(ended, time[1:], 0).cummax(-1).values
    age = torch.arange(num_frames - 1, -1, -1, device=frames.device)
    step = torch.maximum(time[:, None] - age, episode_start.unsqueeze(-1)).flatten(-2)
    history = frames.gather(-2, step.unsqueeze(-1).expand(*step.shape, CELLS_PER_FRAME))
    return history.unflatten(-2, (batch[-1], num_frames))
