"""The Super Mini Map of Google Research Football, compact and dense.

Dense, four stacked frames are 110,592 bytes of which at most 96 are not zero. :class:`MiniMapCells`
keeps the 96 cell indices (192 bytes) and :func:`cells_to_planes` draws them where they are needed,
for example on the GPU, inside a network.
"""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite

from fbrl.checks import check_count
from fbrl.transforms.memory import MemoryTransform
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
from fbrl.transforms.raw_observation import Keys, check_keys, read_fields

__all__ = ["MiniMapCells", "SuperMiniMap", "cells_to_planes"]

_FIELDS = ("left_team", "right_team", "ball", "active", "left_team_roles", "right_team_roles")


class MiniMapCells(MemoryTransform):
    """Super Mini Map as cell indices, stacked over the latest frames.

    Writes ``minimap_cells``, an int16 tensor of shape ``(*batch, num_frames, 24)``, oldest frame
    first. A frame holds the cells of 11 left players, 11 right players, the ball and the active
    player; a cell is ``row * 96 + column`` of gfootball's ``generate_smm``, and -1 marks a player
    who isn't there (roles of -1, a NaN position, or no active player). A reset fills the stack with
    the first frame.

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

    _entries: tuple[str, ...] = ("minimap_cells",)

    def __init__(self, num_frames: int = 4, in_keys: Keys = None, out_keys: Keys = None) -> None:
        super().__init__(
            in_keys=list(_FIELDS) if in_keys is None else in_keys,
            out_keys=list(self._entries) if out_keys is None else out_keys,
        )
        check_keys(self, _FIELDS, self._entries)
        self.num_frames = check_count("num_frames", num_frames)
        self.memory_spec = Bounded(
            ABSENT, NUM_CELLS - 1, (self.num_frames, CELLS_PER_FRAME), dtype=torch.int16
        )

    @property
    def memory_keys(self) -> tuple[NestedKey, ...]:
        """The key of the cells, which hold the frames before."""
        return (self.out_keys[0],)

    def begin(self, state: TensorDictBase) -> None:
        """Fills the stack of episodes that begin with these observations."""
        frames = self._frame(state).unsqueeze(-2).repeat_interleave(self.num_frames, -2)
        state.set(self.out_keys[0], frames)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        (stack,) = self._before(tensordict)
        if stack.dtype != torch.int16 or stack.shape[-2:] != (self.num_frames, CELLS_PER_FRAME):
            raise ValueError(
                f"{type(self).__name__}: {self.out_keys[0]!r} of the step before is {stack.dtype} "
                f"of shape {tuple(stack.shape)}, but must be torch.int16 of shape (*batch, "
                f"{self.num_frames}, {CELLS_PER_FRAME})."
            )
        return self._push(stack, next_tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes the cells of a stored trajectory, unless the batch already has them."""
        if tensordict.get(self.out_keys[0], None) is not None:
            return tensordict
        names = tensordict.names
        if not names or names[-1] != "time":
            raise ValueError(
                f"{type(self).__name__}: frames can only be stacked along time, but the dimensions "
                f"are named {names}. Collect {self.out_keys[0]!r} in the environment, or call "
                "refine_names(..., 'time') on a batch whose last dimension is time."
            )
        done = tensordict.get(("next", "done"), None)
        cells = _stack_history(self._frame(tensordict), done, self.num_frames)
        tensordict.set(self.out_keys[0], cells)
        if ("next", self.in_keys[0]) in tensordict.keys(include_nested=True):
            self._push(cells, tensordict.get("next"))
        return tensordict

    def _frame(self, tensordict: TensorDictBase) -> Tensor:
        return frame_cells(*read_fields(tensordict, self.in_keys, _FIELDS, type(self).__name__))

    def _push(self, stack: Tensor, following: TensorDictBase) -> TensorDictBase:
        """Writes the stack with the frame that follows in place of the oldest one."""
        cells = torch.cat([stack[..., 1:, :], self._frame(following).unsqueeze(-2)], -2)
        return following.set(self.out_keys[0], cells)


class SuperMiniMap(MiniMapCells):
    """Super Mini Map as dense planes, stacked over the latest frames.

    Writes ``smm``, a uint8 tensor of shape ``(*batch, num_frames * 4, 72, 96)`` with 255 at the
    marked cells, and the ``minimap_cells`` of :class:`MiniMapCells`. Channel ``4 * frame + layer``
    holds one of the layers left team, right team, ball and active player; the oldest frame comes
    first. It equals gfootball's ``SMMWrapper`` under ``FrameStack`` with the channels in front.

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

    _entries = ("minimap_cells", "smm")

    def _draw(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set(self.out_keys[1], cells_to_planes(tensordict.get(self.out_keys[0])))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._draw(super()._step(tensordict, next_tensordict))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._draw(super()._reset(tensordict, tensordict_reset))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draws the planes of stored cells, computing the cells first where there are none."""
        self._draw(super().forward(tensordict))
        following = tensordict.get("next", None)
        if following is not None and following.get(self.out_keys[0], None) is not None:
            self._draw(following)
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Adds the cells and the planes to the observation."""
        observation_spec = super().transform_observation_spec(observation_spec)
        channels, device = self.num_frames * len(SMM_LAYERS), observation_spec.device
        shape = (*observation_spec.shape, channels, SMM_HEIGHT, SMM_WIDTH)
        observation_spec[self.out_keys[1]] = Bounded(0, 255, shape, device, torch.uint8)
        return observation_spec


def _stack_history(frames: Tensor, done: Tensor | None, num_frames: int) -> Tensor:
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
