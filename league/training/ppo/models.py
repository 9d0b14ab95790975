"""Parts for rsl-rl: pictures as bytes, and distributions of bounded actions and choices."""

from collections.abc import Generator, Mapping
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from rsl_rl.models import CNNModel, MLPModel
from rsl_rl.modules.distribution import Distribution, GaussianDistribution
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor, nn

from league.envs.actions import ContinuousActions
from league.training.config import TrainConfig

CONTRAST = 4.0
"""Learners see pictures from 0 to 4, so that their brightness varies by about 1: with pictures from
0 to 1 the first layer learns slowly. A power of two: checkpoints, which have weights for pictures
from 0 to 1, answer the same bit for bit."""
FIRST = "cnns.stereo.0.weight"  # the weights that pictures are multiplied by
Weight = TypeVar("Weight", np.ndarray, Tensor)


def with_contrast(weights: Mapping[str, Weight], by: float) -> dict[str, Weight]:
    """Return an actor's weights, of which those for pictures are scaled."""
    return {name: weight * by if name == FIRST else weight for name, weight in weights.items()}


class ByteCNNModel(CNNModel):
    """A CNNModel for pictures as bytes, a quarter of the memory traffic of floats.

    Pictures and weights have the channels last in memory: on a CPU an update takes an eighth less.
    """

    def __init__(self, *settings: object, **named: object) -> None:
        """Build the layers; see CNNModel."""
        super().__init__(*settings, **named)  # type: ignore
        self.cnns.to(memory_format=torch.channels_last)  # type: ignore

    def get_latent(self, obs: TensorDict, masks=None, hidden_state=None) -> Tensor:  # noqa: ANN001
        """Return the features of the pictures, after the groups of numbers."""
        features = []
        if self.obs_groups:
            flat = torch.cat([obs[group] for group in self.obs_groups], dim=-1)
            features.append(self.obs_normalizer(flat))
        for group in self.obs_groups_2d:
            picture = obs[group].contiguous(memory_format=torch.channels_last)
            if picture.dtype == torch.uint8:
                picture = picture.to(torch.float32).div_(255.0 / CONTRAST)  # in place: it is large
            else:
                picture = picture * CONTRAST
            features.append(self.cnns[group](picture))
        return torch.cat(features, dim=-1)


class PictureStorage(RolloutStorage):
    """A RolloutStorage that copies whole pictures into its mini-batches.

    rsl-rl copies them byte by byte, which is slow on a CPU.
    """

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Generator[RolloutStorage.Batch]:
        """Yield the mini-batches that rsl-rl yields."""
        stored, pictures = self.observations, self.observations["stereo"].flatten(0, 1)
        rows = torch.arange(len(pictures), device=self.device).view(stored.batch_size)
        self.observations = stored.exclude("stereo").set("row", rows)
        try:
            for batch in super().mini_batch_generator(num_mini_batches, num_epochs):
                obs = batch.observations
                assert obs is not None
                obs["stereo"] = pictures.index_select(0, obs.pop("row"))
                yield batch
        finally:
            self.observations = stored


class _NearZero(Distribution):
    """Has an actor's last layer scaled, so that at initialisation it outputs values near 0.

    With torch's own initialisation the first update throws half of all seeds beyond the range of
    actions for good. Andrychowicz et al., "What Matters In On-Policy Reinforcement Learning?"
    (2020), section 3.2, scale it like this.
    """

    def init_mlp_weights(self, mlp: nn.Module) -> None:
        """Start at the middle of each action's range, or with equal probabilities."""
        last = [layer for layer in mlp.modules() if isinstance(layer, nn.Linear)][-1]
        with torch.no_grad():
            last.weight.mul_(0.01)
            last.bias.zero_()


class BoundedGaussian(_NearZero, GaussianDistribution):
    """A Gaussian with a mean that is pulled back where it leaves [-1, 1], the range of actions.

    The worlds clip actions, so beyond the range the reward has no gradient, and a mean that has
    drifted off stays there: a car that asks for far more than full speed never tries to brake
    earlier. The pull is the gradient of weight / 2 times the mean square of the excess.
    """

    def __init__(self, output_dim: int, pull: float = 0.0, **settings: object) -> None:
        """Set the weight of the pull."""
        super().__init__(output_dim, **settings)  # type: ignore
        self._pull = pull

    def update(self, mlp_output: Tensor) -> None:
        """Set the means; their gradient gains the pull."""
        super().update(mlp_output)
        if mlp_output.requires_grad:
            mlp_output.register_hook(partial(self._pulled, mlp_output.detach()))

    def _pulled(self, means: Tensor, gradient: Tensor) -> Tensor:
        excess = means - means.clamp(-1.0, 1.0)
        return gradient + self._pull / len(means) * excess


class Categorical(_NearZero):
    """Categorical distribution of one-hot actions, (num_rows, size)."""

    _scores: Tensor

    def update(self, mlp_output: Tensor) -> None:
        """Set the log probabilities."""
        self._scores = torch.log_softmax(mlp_output, dim=-1)

    def sample(self) -> Tensor:
        """Draw a choice for each row."""
        chosen = torch.multinomial(self._scores.exp(), 1)
        return torch.zeros_like(self._scores).scatter_(1, chosen, 1.0)

    def deterministic_output(self, mlp_output: Tensor) -> Tensor:
        """Return the logits, of which the largest is chosen."""
        return mlp_output

    def as_deterministic_output_module(self) -> nn.Module:
        """Return the identity."""
        return nn.Identity()

    @property
    def input_dim(self) -> int:
        """Outputs of the network."""
        return self.output_dim

    @property
    def mean(self) -> Tensor:
        """Probabilities of the choices."""
        return self._scores.exp()

    @property
    def std(self) -> Tensor:
        """Standard deviation of each choice's indicator."""
        share = self._scores.exp()
        return (share * (1.0 - share)).sqrt()

    @property
    def entropy(self) -> Tensor:
        """Entropy of each row [nat], (num_rows,)."""
        return -(self._scores.exp() * self._scores).sum(dim=-1)

    @property
    def params(self) -> tuple[Tensor, ...]:
        """Log probabilities."""
        return (self._scores,)

    def log_prob(self, outputs: Tensor) -> Tensor:
        """Return the log probability of one-hot choices, (num_rows,)."""
        return (outputs * self._scores).sum(dim=-1)

    def kl_divergence(
        self, old_params: tuple[Tensor, ...], new_params: tuple[Tensor, ...]
    ) -> Tensor:
        """Return KL(old || new) of each row [nat]."""
        (old,), (new,) = old_params, new_params
        return (old.exp() * (old - new)).sum(dim=-1)


def actor_settings(cfg: TrainConfig) -> dict[str, object]:
    """Return rsl-rl's settings of an actor."""
    network, pictures = cfg.network, cfg.sensors.camera is not None
    distribution: dict[str, object] = {"class_name": Categorical}
    if isinstance(cfg.action_space, ContinuousActions):
        # A schedule sets the deviation: by gradient it falls too slowly to race at the edge.
        spread = {"init_std": cfg.ppo.noise[0], "std_type": "log", "learn_std": False}
        distribution = {"class_name": BoundedGaussian, "pull": cfg.ppo.pull, **spread}
    settings: dict[str, object] = {
        "class_name": ByteCNNModel if pictures else MLPModel,
        "hidden_dims": list(network.hidden),
        "activation": network.activation,
        "obs_normalization": network.normalise,
        "distribution_cfg": distribution,
    }
    if pictures:
        settings["cnn_cfg"] = {
            "output_channels": list(network.channels),
            "kernel_size": list(network.kernels),
            "stride": list(network.strides),
            "activation": network.activation,
        }
    return settings
