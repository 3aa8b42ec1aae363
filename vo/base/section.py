"""Frozen groups of settings, which pydantic validates where they differ from the defaults.

pydantic and the models of all settings take 65 ms of the 0.45 s of a start, so that a run with the
defaults does not load it. A section declares its settings as a model of pydantic does, by
annotations, which are read when the first value must be validated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NoReturn, get_type_hints

if TYPE_CHECKING:
    from typing import Self

    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

Change = Callable[[Any], Any]
_models: dict[type[Section], type[BaseModel]] = {}


class _Setting:
    """Default of a setting, functions that change or refuse values, options of its `Field`."""

    def __init__(
        self,
        default: Any,
        before: Change | None = None,
        after: Change | None = None,
        **options: Any,
    ) -> None:
        self.default, self.before, self.after, self.options = default, before, after, options


def setting(default: Any, **options: Any) -> Any:
    """A setting, with the options of a pydantic `Field`, such as `ge` and `description`.

    Before and after pydantic validates a value, functions `before` and `after` may change it.
    """
    return _Setting(default, **options)


def expert(default: Any, **options: Any) -> Any:
    """A setting marked as one for experts."""
    return setting(default, json_schema_extra={"expert": True}, **options)


class _Fields:
    """Attribute of a class: its settings as pydantic knows them."""

    def __get__(self, instance: object, owner: type[Section]) -> dict[str, FieldInfo]:
        return _model(owner).model_fields


class Section:
    """A frozen group of settings; unknown keys are errors.

    Attributes of a class are the defaults, those of an instance the values that were given.
    """

    model_fields = _Fields()
    _declared: ClassVar[dict[str, _Setting]] = {}

    def __init_subclass__(cls) -> None:
        given = {name: cls.__dict__[name] for name in cls.__dict__.get("__annotations__", ())}
        declared = {n: v if isinstance(v, _Setting) else _Setting(v) for n, v in given.items()}
        cls._declared = cls._declared | declared
        for name, each in declared.items():
            setattr(cls, name, each.default)

    def __init__(self, **values: Any) -> None:
        """Validate the values; others have their defaults.

        Raises:
            pydantic.ValidationError: a ValueError: an unknown name, or a value that is not allowed.
        """
        self.__dict__.update(_validated(type(self), values))

    @classmethod
    def model_validate(cls, values: Mapping[Any, Any]) -> Self:
        """A section with these values, which may be mappings for sections inside it."""
        return cls.model_construct(**_validated(cls, values))

    @classmethod
    def model_construct(cls, **values: Any) -> Self:
        """A section with these values, which are not validated."""
        made = object.__new__(cls)
        made.__dict__.update(values)
        return made

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """A copy with other values, which are not validated."""
        return self.model_construct(**self.__dict__ | dict(update or {}))

    def model_dump(self, mode: str = "python") -> dict[str, Any]:
        """All settings by their names; with mode `json`, lists in place of tuples."""
        return {name: _dumped(getattr(self, name), mode) for name in self._declared}

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all settings."""
        return tuple(cls._declared)

    def _values(self) -> tuple[Any, ...]:
        return tuple(getattr(self, name) for name in self._declared)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Section) or type(other) is not type(self):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def __repr__(self) -> str:
        values = zip(self._declared, self._values(), strict=True)
        return f"{type(self).__name__}({', '.join(f'{n}={v!r}' for n, v in values)})"

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise ValueError(f"{type(self).__name__} is frozen; make another one by model_copy")

    def __delattr__(self, name: str) -> NoReturn:
        raise ValueError(f"{type(self).__name__} is frozen")


def _validated(cls: type[Section], values: Mapping[Any, Any]) -> dict[str, Any]:
    """The values as they were meant, such as numbers for their texts, by pydantic."""
    defaults = {name: each.default for name, each in cls._declared.items()}
    ready = {
        name: value
        for name, value in values.items()
        if isinstance(value, Section) and type(value) is type(defaults.get(name))
    }
    rest = {name: value for name, value in values.items() if name not in ready}
    return ready | (_given(cls, _model(cls).model_validate(rest)) if rest else {})


def _given(cls: type[Section], model: BaseModel) -> dict[str, Any]:
    """The values that a model was given; sections in place of models inside it."""
    given = {}
    for name in cls._declared:
        if name in model.model_fields_set:
            default, value = cls._declared[name].default, getattr(model, name)
            is_section = isinstance(default, Section)
            given[name] = (
                default.model_construct(**_given(type(default), value)) if is_section else value
            )
    return given


def _model(cls: type[Section]) -> type[BaseModel]:
    """The settings of a class as a model of pydantic."""
    if cls in _models:
        return _models[cls]
    import pydantic

    hints = get_type_hints(cls, localns=vars(pydantic) | {"Any": Any}, include_extras=True)
    fields: dict[str, Any] = {}
    for name, each in cls._declared.items():
        is_section = isinstance(each.default, Section)
        hint = _model(type(each.default)) if is_section else hints[name]
        for change, kind in (
            (each.before, pydantic.BeforeValidator),
            (each.after, pydantic.AfterValidator),
        ):
            hint = Annotated[hint, kind(change)] if change else hint
        fields[name] = (hint, pydantic.Field(each.default, **each.options))
    config = pydantic.ConfigDict(frozen=True, extra="forbid")
    _models[cls] = pydantic.create_model(
        cls.__name__, __config__=config, __doc__=cls.__doc__, **fields
    )
    return _models[cls]


def _dumped(value: Any, mode: str) -> Any:
    if isinstance(value, Section):
        return value.model_dump(mode)
    if isinstance(value, tuple) and mode == "json":
        return [_dumped(each, mode) for each in value]
    return value
