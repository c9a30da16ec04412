"""The audit follows articulations by equations of its own: true recordings pass, and no falsified one does."""

import falsified
import pytest

import nsdyn as nd


@pytest.mark.parametrize("name", falsified.RUNS)
def test_true_recordings_pass(name):
    audit = nd.check(falsified.true(name))
    assert audit.passed, audit


@pytest.mark.parametrize("kind", falsified.KINDS)
def test_falsified_recordings_do_not_pass(kind):
    audit = nd.check(falsified.false(kind))
    assert not audit.passed and audit.verdict.startswith("FAILED"), audit
