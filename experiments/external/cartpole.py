"""CartPole of Gymnasium as an environment of jitai."""

from jitai import environment

environment.serve(
    "CartPole-v1",
    features=["position", "velocity", "angle", "angular_velocity"],
    actions=["left", "right"],
    unit="steps",
)
