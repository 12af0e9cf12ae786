"""What actions are drawn from, against torch's own distributions and by sampling."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.distributions import Categorical as TorchCategorical
from torch.distributions import Independent, Normal, TransformedDistribution, kl_divergence
from torch.distributions.transforms import TanhTransform

from train.networks.actor_critic import ActorCritic
from train.networks.distributions import Categorical, SquashedNormal
from train.networks.features import Features
from train.networks.layers import Hidden


def squashed(mean: torch.Tensor, log_std: torch.Tensor) -> TransformedDistribution:
    """Torch's own distribution of tanh of normal numbers, with the factor of its density."""
    normal = Independent(Normal(mean, log_std.exp()), 1)
    return TransformedDistribution(normal, [TanhTransform(cache_size=1)])


def two_policies() -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Means [64, 3] and logarithms of deviations [3] of two policies, float64."""
    generator = torch.Generator().manual_seed(0)
    shapes = (64, 3), (3,)
    return [
        tuple(0.5 * torch.randn(shape, generator=generator).double() for shape in shapes)  # type: ignore[misc]
        for _ in range(2)
    ]


def test_the_factor_of_tanh_cancels_in_ratios_and_gradients() -> None:
    (mean, log_std), (other, other_std) = two_policies()
    leaves = [mean.clone().requires_grad_(), log_std.clone().requires_grad_()]
    drawn = SquashedNormal(mean, log_std).draw().detach()
    ours = SquashedNormal(*leaves).log_prob(drawn)
    theirs = squashed(*leaves).log_prob(drawn.tanh())
    before = SquashedNormal(other, other_std).log_prob(drawn)
    theirs_before = squashed(other, other_std).log_prob(drawn.tanh())
    torch.testing.assert_close(ours - before, theirs - theirs_before)
    assert (ours - theirs).abs().min() > 1e-4  # each by itself differs, by the factor
    for a, b in zip(
        torch.autograd.grad(ours.sum(), leaves),
        torch.autograd.grad(theirs.sum(), leaves),
        strict=True,
    ):
        torch.testing.assert_close(a, b)


def test_log_probabilities_are_exact_where_tanh_is_rounded_to_one() -> None:
    mean, log_std = torch.full((1000, 2), 9.0), torch.full((2,), -0.5)
    policy = SquashedNormal(mean, log_std)
    drawn = policy.draw()
    assert (policy.action(drawn) == 1.0).any() and (policy.action(drawn) <= 1.0).all()
    exact = Independent(Normal(mean.double(), log_std.double().exp()), 1).log_prob(drawn.double())
    torch.testing.assert_close(policy.log_prob(drawn).double(), exact, rtol=1e-4, atol=1e-4)


def test_entropy_and_divergence_of_normals_are_torchs() -> None:
    (mean, log_std), (other, other_std) = two_policies()
    ours, before = SquashedNormal(mean, log_std), SquashedNormal(other, other_std)
    theirs, theirs_before = (
        Independent(Normal(policy.mean, policy.log_std.exp().expand(64, 3)), 1)
        for policy in (ours, before)
    )
    torch.testing.assert_close(ours.entropy(), theirs.entropy())
    divergence = ours.divergence(before.parameters)
    torch.testing.assert_close(divergence, kl_divergence(theirs_before, theirs))
    torch.testing.assert_close(ours.divergence(ours.parameters), torch.zeros(64).double())


def test_tanh_changes_the_entropy_but_not_the_divergence_by_sampling() -> None:
    torch.manual_seed(0)
    (mean, log_std), (other, other_std) = two_policies()
    mean, other = mean[:1], other[:1]
    ours, before = SquashedNormal(mean, log_std), SquashedNormal(other, other_std)
    actions = before.action(SquashedNormal(other.expand(400_000, 3), other_std).draw())
    logarithm = squashed(other, other_std).log_prob(actions)
    sampled = (logarithm - squashed(mean, log_std).log_prob(actions)).mean()
    assert float(sampled) == pytest.approx(float(ours.divergence(before.parameters)), abs=0.01)
    drawn = SquashedNormal(other.expand(400_000, 3), other_std).draw()
    assert float(-before.log_prob(drawn).mean()) == pytest.approx(float(before.entropy()), abs=0.01)
    assert float(-logarithm.mean()) < float(before.entropy()) - 0.1


def test_normal_draws_have_their_mean_and_deviation_and_the_greedy_one_is_the_median() -> None:
    torch.manual_seed(0)
    mean, log_std = torch.tensor([-1.0, 0.2]), torch.tensor([-1.0, 0.3])
    policy = SquashedNormal(mean.expand(200_000, 2), log_std)
    drawn = policy.draw()
    torch.testing.assert_close(drawn.mean(0), mean, rtol=0.0, atol=0.02)
    torch.testing.assert_close(drawn.std(0), log_std.exp(), rtol=0.02, atol=0.0)
    median = policy.action(drawn).median(dim=0).values
    torch.testing.assert_close(policy.action(policy.mean)[0], median, rtol=0.0, atol=0.02)


def test_choices_are_torchs_and_keep_to_masks() -> None:
    torch.manual_seed(0)
    logits, other = torch.randn(2, 64, 5).double()
    allowed = torch.rand(64, 5) < 0.6
    allowed[:, 2] = True
    for mask in (None, allowed):
        ours, before = Categorical(logits, mask), Categorical(other, mask)
        shut = [
            value if mask is None else value.masked_fill(~mask, -1e9) for value in (logits, other)
        ]
        theirs, theirs_before = (TorchCategorical(logits=value) for value in shut)
        drawn = ours.draw()
        assert mask is None or mask.gather(1, drawn[:, None]).all()
        torch.testing.assert_close(ours.log_prob(drawn), theirs.log_prob(drawn))
        torch.testing.assert_close(ours.entropy(), theirs.entropy())
        expected = kl_divergence(theirs_before, theirs)
        torch.testing.assert_close(ours.divergence(before.parameters), expected)
    wide = Categorical(logits[:1].expand(200_000, 5)).draw()
    share = torch.bincount(wide, minlength=5) / 200_000
    torch.testing.assert_close(share.double(), logits[0].softmax(-1), rtol=0.0, atol=0.005)


def test_a_network_acts_as_its_distribution_says() -> None:
    torch.manual_seed(0)
    features = Features("flat", (6,), np.ones(6))
    assert repr(features) == "Features(kind='flat', shape=(6,), num_rows=0, network='')"
    network = ActorCritic(features, 3, Hidden(16), action_std=0.4)
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    observation, noise = torch.randn(32, 6), torch.randn(32, 3)
    with torch.no_grad():
        policy = network.distribution(network(observation)[0])
        assert isinstance(policy, SquashedNormal)
        torch.testing.assert_close(policy.log_std.exp(), torch.full((3,), 0.4))
        greedy, drawn = network.act(observation, None), network.act(observation, noise)
    assert torch.equal(greedy, policy.action(policy.mean))
    torch.testing.assert_close(drawn, (policy.mean + 0.4 * noise).tanh())
    assert "log_std" not in ActorCritic(features, 3, Hidden(16)).state_dict()
