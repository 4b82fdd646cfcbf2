"""Run jax-sysid on records and print nothing: `python jax_peer.py MATERIAL.npz ANSWER.npz`.

A program of its own, because jax-sysid wants an older scipy than ours: it imports nothing of
narxcal, and `narxcal benchmark --jax-python` runs it by the interpreter of an environment that has
jax-sysid. The model is the recurrent network of its paper (Bemporad 2025): L-BFGS after Adam on the
simulation error, the initial state smoothed from the given window.
"""

import os
import sys
import time
from typing import Any

import numpy as np

_ORDER, _HIDDEN = 4, 10  # of the figures in its own paper
_EPOCHS, _STEPS = 500, 2000  # of Adam and of L-BFGS
NOTE = f"{_ORDER} states, {_HIDDEN} hidden"


def main(material: str, answer: str) -> None:
    """Fit to records u0, y0, u1, ... and run free on inputs v0, ... after outputs w0, ..."""
    os.environ["JAX_ENABLE_X64"] = "1"  # its initial states are float64
    from flax import linen as nn  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415
    from jax_sysid.models import RNN  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415
    from jax_sysid.utils import standard_scale  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415

    with np.load(material, allow_pickle=False) as given:
        us, ys, tests, starts = (_numbered(given, letter) for letter in "uyvw")
    began = time.process_time()
    _, mean_y, gain_y = standard_scale(np.concatenate(ys))
    _, mean_u, gain_u = standard_scale(np.concatenate(us))

    def layers(outputs: int) -> type:
        def call(_self: Any, xu: Any) -> Any:
            return nn.Dense(outputs)(nn.tanh(nn.Dense(_HIDDEN)(xu)))

        return type("Layers", (nn.Module,), {"__call__": nn.compact(call)})

    p, m = ys[0].shape[1], us[0].shape[1]
    model = RNN(_ORDER, p, m, FX=layers(_ORDER), FY=layers(p), x_scaling=0.1, y_in_x=False)
    model.loss(rho_x0=1e-4, rho_th=1e-4)
    model.optimization(adam_epochs=_EPOCHS, lbfgs_epochs=_STEPS, iprint=-1)
    model.fit([(y - mean_y) * gain_y for y in ys], [(u - mean_u) * gain_u for u in us])
    spent = time.process_time() - began
    found: dict[str, Any] = {}
    for number, (u, start) in enumerate(zip(tests, starts, strict=True)):
        inputs = (u - mean_u) * gain_u
        x0 = model.learn_x0(inputs[: len(start)], (start - mean_y) * gain_y, RTS_epochs=10)
        free = np.asarray(model.predict(x0, inputs)[0]).reshape(len(u), p) / gain_y + mean_y
        found[f"y{number}"] = np.concatenate([start, free[len(start) :]])
    np.savez(answer, cpu_s=np.array(spent), **found)


def _numbered(given: Any, letter: str) -> list[Any]:
    return [given[key] for key in sorted(given, key=lambda k: int(k[1:])) if key[0] == letter]


if __name__ == "__main__":
    main(*sys.argv[1:])
