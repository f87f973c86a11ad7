"""Reinforcement-learning experiments for just-in-time adaptive interventions.

``import jitai`` registers ``jitai/StepCount-v0`` and the other families with Gymnasium. ``docs/python.md`` is the manual.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jitai._registration import ENVIRONMENT_ID, register

if TYPE_CHECKING:
    from jitai._jitai import VERSION as __version__
    from jitai._environment import Env, StepCountEnv
    from jitai._experiment import Checked, ManifestError, Plan, Report, Run, check, plan, report, run
    from jitai._figures import Figure, Figures
    from jitai._fit import Fit, fit
    from jitai._policy import Policy
    from jitai._registration import make, make_vec
    from jitai._store import Store, open
    from jitai._vector import StepCountVectorEnv, VectorEnv

__all__ = [
    "ENVIRONMENT_ID",
    "Checked",
    "Env",
    "Figure",
    "Figures",
    "Fit",
    "ManifestError",
    "Plan",
    "Policy",
    "Report",
    "Run",
    "StepCountEnv",
    "StepCountVectorEnv",
    "Store",
    "VectorEnv",
    "__version__",
    "check",
    "fit",
    "make",
    "make_vec",
    "open",
    "plan",
    "report",
    "run",
]

#: Names of the compiled module, which programs without simulations of ours do not load.
_NATIVE = {"__version__": "VERSION"}
_LAZY = {
    "__version__": "jitai._jitai",
    **dict.fromkeys(
        ("Checked", "ManifestError", "Plan", "Report", "Run", "check", "plan", "report", "run"),
        "jitai._experiment",
    ),
    "Figure": "jitai._figures",
    "Figures": "jitai._figures",
    "Fit": "jitai._fit",
    "fit": "jitai._fit",
    "Policy": "jitai._policy",
    "Store": "jitai._store",
    "open": "jitai._store",
    "Env": "jitai._environment",
    "StepCountEnv": "jitai._environment",
    "StepCountVectorEnv": "jitai._vector",
    "VectorEnv": "jitai._vector",
    "make": "jitai._registration",
    "make_vec": "jitai._registration",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        return getattr(importlib.import_module(_LAZY[name]), _NATIVE.get(name, name))
    raise AttributeError(f"module 'jitai' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


register()
