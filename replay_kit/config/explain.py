"""What is wrong with a configuration, in words."""

from typing import Any, get_args

from pydantic import BaseModel, ValidationError


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Return what is wrong with a configuration: each key with its value, and the known keys where one is unknown.

    Args:
        error: Of the validation.
        model: What was validated.
    """
    lines = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = sorted(_known_keys(model, item["loc"][:-1]))
            lines.append(f"unknown key '{key}'; known here: {', '.join(known)}")
        else:
            lines.append(f"'{key}': {item['msg'].removeprefix('Value error, ')}, got {item['input']!r}")
    return "; ".join(lines)


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys known at a place: of a section, or of an entry of a list whose kind is stated."""
    for part in location:
        if isinstance(part, int) or part not in model.model_fields:
            continue
        found = [kind for kind in _models_in(model.model_fields[part].annotation) if _is_kind(kind, location)]
        if not found:
            break
        model = found[0]
    return list(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _is_kind(model: type[BaseModel], location: tuple[int | str, ...]) -> bool:
    """Return whether a model is what a place in the configuration says: pydantic names an entry's kind in the place."""
    kinds = get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()
    return len(kinds) != 1 or kinds[0] in location
