"""Reading ``study.toml``: every mistake is named with its key."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ostiform.errors import InputError
from ostiform.study.contradictions import contradictions, quoted, shown
from ostiform.study.settings import StudySettings


def read_settings(path: Path) -> StudySettings:
    """Read and check a study file.

    Raises
    ------
    InputError
        If the file is missing, not TOML, or a key is unknown, missing or wrong; every problem is
        named with its key.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: expected a study file, found none: check the path") from None
    except OSError as error:
        raise InputError(
            f"{path}: expected a study file, found one that cannot be read ({error.strerror})"
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: expected text in UTF-8, found other bytes: save the file as UTF-8"
        ) from None
    return parsed_settings(text, path.name)


def parsed_settings(text: str, source: str = "study.toml") -> StudySettings:
    """Return the settings that a text in TOML states; errors name the key after `source`.

    Raises
    ------
    InputError
        As `read_settings`.
    """
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: expected TOML, found a mistake: {error}") from None
    try:
        settings = StudySettings.model_validate(content)
    except ValidationError as error:
        problems = [_described(item) for item in error.errors(include_url=False)]
        raise InputError(f"{source}: {'; '.join(problems)}") from None
    if problems := contradictions(settings):
        raise InputError(f"{source}: {'; '.join(problems)}")
    return settings


def _described(item: Any) -> str:
    key = ""
    for step in item["loc"]:
        if isinstance(step, int):
            key += f"[{step}]"
        elif step == "[key]":
            key += " (its name)"
        elif not _is_alternative(str(step)):
            key += f".{quoted(str(step))}" if key else quoted(str(step))
    kind, context = item["type"], item.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{key}: unknown key: check its spelling and its table"
    if kind == "missing":
        return f"{key}: expected this key, found none"
    if kind == "literal_error":
        return f"{key}: expected {context['expected']}, found {shown(item['input'])}"
    if kind == "string_pattern_mismatch":
        return (
            f"{key}: expected a name without spaces at its start and none of . / \\ {{ }} = +, "
            f"found {shown(item['input'])}"
        )
    message = item["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    return f"{key}: expected {message}, found {shown(item['input'])}"


def _is_alternative(step: str) -> bool:
    """Whether a step of the location is a member of a union, not a key of the file."""
    return step in ("str", "int", "float") or "[" in step
