"""The call of a generated function from Python, in C where this Python's headers are."""

import sys
import sysconfig
from importlib import resources
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from clikgen.runtime.compiler import compile_library
from clikgen.runtime.documents import BadInput

Function = TypeVar("Function")


class NoExtension(Exception):
    """Why calls are made in Python."""


def called_in_c(base: type[Function]) -> type[Function]:
    """The class derived from `base`, CompiledFunction, whose call is in C; compiled if the cache lacks it.

    Raises NoExtension where it cannot be: without the headers of Python, or with a compiler that refuses them.
    """
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").is_file():
        raise NoExtension(f"{headers} has no Python.h")
    version = f"-DCLIKGEN_FOR={sys.implementation.cache_tag}_{np.__version__}"  # another one compiles anew
    flags = ("-std=c11", version, f"-I{headers}", f"-I{np.get_include()}")
    try:
        path = compile_library([Path(str(resources.files(__package__))) / "extension.c"], extra=flags)
        loader = ExtensionFileLoader(f"{__package__}.extension", str(path))
        spec = spec_from_loader(loader.name, loader)
        assert spec
        module = module_from_spec(spec)
        loader.exec_module(module)
    except (BadInput, ImportError) as error:
        raise NoExtension(str(error)) from None
    return cast(type[Function], module.called_in_c(base))
