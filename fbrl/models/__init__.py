"""Neural networks: trunks for the observations, and the actor-critic on top of them."""
