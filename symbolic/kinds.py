"""Kinds found as the files of a folder: each file's class `Spec` is one choice of a table, told by its key `kind`."""

import pkgutil
from collections.abc import Mapping
from functools import reduce
from importlib import import_module
from operator import or_
from types import ModuleType
from typing import Annotated, Any, get_args

from pydantic import BeforeValidator, Field

from clikgen.runtime.documents import choices


def kinds_in(package: ModuleType) -> dict[str, Any]:
    """The class `Spec` of every file in a package, by the file's name."""
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    return {name: import_module(f"{package.__name__}.{name}").Spec for name in names}


def one_of(package: ModuleType) -> Any:
    """The type, for pydantic, of a table whose `kind` names a file of the package; an unknown kind lists them all."""
    kinds = tuple(kinds_in(package).values())
    names = [get_args(kind.model_fields["kind"].annotation)[0] for kind in kinds]

    def known(table: Any) -> Any:
        if isinstance(table, Mapping) and table.get("kind") not in names:
            got = f"no kind '{table['kind']}'" if "kind" in table else "no key 'kind'"
            raise ValueError(f"{got}; {choices(str(table.get('kind', '')), names)}")
        return table

    union = kinds[0] if len(kinds) == 1 else Annotated[reduce(or_, kinds), Field(discriminator="kind")]
    return Annotated[union, BeforeValidator(known)]
