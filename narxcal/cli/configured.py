"""What a command reads first: the configuration, with the folder of the logs overridden."""

from __future__ import annotations

from pathlib import Path

from narxcal.errors import ConfigError
from training.config import RunConfig, load_config


def read_config(path: str, data: Path | None) -> tuple[RunConfig, Path]:
    """Read CONFIG; `data` takes the place of `[logs] folder`.

    Returns the configuration and the folder that its paths are relative to; raises
    `ConfigError` as `load_config`.
    """
    if Path(path).is_dir():
        raise ConfigError(
            "a configuration is a file, and this is a folder",
            file=path,
            hint="Name the TOML file in it",
        )
    try:
        config, base = load_config(path)
    except ConfigError as error:
        if error.file is not None:
            raise
        raise ConfigError(
            error.problem, file=path, channel=error.channel, hint=error.hint
        ) from None
    if data is None:
        return config, base
    logs = config.logs.model_copy(update={"folder": str(data.resolve())})
    return config.model_copy(update={"logs": logs}), base
