"""Base class of all sections of a scene, and checks of tabulated distributions."""

from typing import Any

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, field_validator
from pydantic_core import CoreSchema

from surveysim.scene.units import shown


class Section(BaseModel):
    """Base of a scene's sections: frozen, without unknown keys; keys of the file have no unit in their name.

    The docstring of a field is its description in the schema, from which the reference of all keys is made.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        populate_by_name=False,
        strict=False,
        defer_build=True,
    )

    @field_validator("*", mode="before")
    @classmethod
    def _no_key_is_true_or_false(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"found {str(value).lower()}; no key of a scene is true or false")
        return value

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe fields by their docstrings."""
        from surveysim.scene.field_docs import field_docs

        schema = handler(core_schema)
        keys, docs = handler.resolve_ref_schema(schema)["properties"], field_docs(cls)
        for name, field in cls.model_fields.items():
            key = field.alias or name
            if key in keys and name in docs:
                keys[key]["description"] = docs[name]
        return schema


def check_quantiles(name: str, probabilities: tuple[float, ...], values: tuple[float, ...]) -> None:
    """Raise ValueError unless the values are quantiles, with probabilities between 0 and 1."""
    check_knots(f"{name}_probabilities", probabilities, name, values)
    if not all(0 < p < 1 for p in probabilities):
        raise ValueError(f"{name}_probabilities: found {shown(probabilities)}; values between 0 and 1 are expected")


def check_knots(x_name: str, x: tuple[float, ...], y_name: str, y: tuple[float, ...]) -> None:
    """Raise ValueError unless x increases, y is not negative and does not decrease, and the lengths agree."""
    if len(x) != len(y) or not x:
        raise ValueError(f"{y_name}: found {len(y)} values for {len(x)} {x_name}; as many as these are expected")
    if any(b <= a for a, b in zip(x, x[1:], strict=False)):
        raise ValueError(f"{x_name}: found {shown(x)}; increasing values are expected")
    if min(y) < 0 or any(b < a for a, b in zip(y, y[1:], strict=False)):
        raise ValueError(f"{y_name}: found {shown(y)}; values of 0 or more that do not decrease are expected")
