"""When compiled code is taken from the cache, and when it is out of date."""

import json
import subprocess
import sys

import pytest

STAMPS = """
import importlib, json, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
from creak.compiling import _stamps
print(json.dumps({f"{d.py_func.__module__}.{d.py_func.__name__}": sorted(map(repr, _stamps[d])) for d in _stamps}))
"""


def stamps(*modules):
    done = subprocess.run([sys.executable, "-c", STAMPS, *modules], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("first", ["creak.location", "creak.significance", "creak.sources.canbus", "creak.gap"])
def test_what_is_imported_first_does_not_put_cached_code_out_of_date(first):
    """Kills stamps that depend on the order: every command would compile again what the one before it did."""
    after, before = stamps(first, "creak.monitor"), stamps("creak.monitor", first)
    assert after == before
    assert "creak.moments.residual_moments" in after


def test_a_function_is_stamped_with_the_files_of_what_it_calls():
    """Kills a change of a shared loop that the functions which hold it do not see."""
    found = stamps("creak.monitor")
    own, calls = found["creak.hermitian.load"], found["creak.rows.edge_rows"]
    assert len(own) == 1
    assert own[0] in calls
    assert len(calls) == 3  # its own, and those of the packed matrices and of the residuals


FUSED = """
import sys
import creak.gap, creak.preparation
from creak.compiling import _called, _stamps

def fused(dispatcher):
    return bool(dispatcher.targetoptions.get("fastmath"))

def inlined(dispatcher):
    return dispatcher.targetoptions.get("inline") == "always"

loops = [d for d in _stamps if fused(d)]
assert len(loops) > 15
for loop in loops:
    for callee in _called(loop.py_func):
        if not inlined(callee):
            print(loop.py_func.__name__, "calls", callee.py_func.__name__)
"""


def test_loops_whose_products_are_fused_call_nothing_that_stands_by_itself():
    """Kills figures whose last bits hang on whether the code was compiled just now or comes from the cache.

    Of a function that is called, a process that compiles has two copies, optimised apart, and runs either.
    """
    done = subprocess.run([sys.executable, "-c", FUSED], capture_output=True, text=True, check=True)
    assert done.stdout == ""
