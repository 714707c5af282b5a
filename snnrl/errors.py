"""What a user got wrong, in one line; lowest of all, so that every room may say it."""

from __future__ import annotations


class ConfigError(ValueError):
    """One value of a configuration is wrong; the message names key, value and what is allowed."""

    def __init__(self, key: str, value: object, allowed: str) -> None:
        super().__init__(f"{key}={value}: {allowed}")
