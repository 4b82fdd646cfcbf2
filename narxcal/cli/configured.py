"""What a command reads first: the configuration, with the folder of the logs overridden."""

from __future__ import annotations

from pathlib import Path

from training.config import RunConfig, load_config


def read_config(path: str, data: Path | None) -> tuple[RunConfig, Path]:
    """Read CONFIG; `data` takes the place of `[logs] folder`.

    Returns the configuration and the folder that its paths are relative to; raises
    `ConfigError` as `load_config`.
    """
    config, base = load_config(path)
    if data is None:
        return config, base
    logs = config.logs.model_copy(update={"folder": str(data.resolve())})
    return config.model_copy(update={"logs": logs}), base
