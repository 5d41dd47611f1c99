import pytest

from ostiform.fitting import fit_prior
from tests.fitting.fitting_cases import stored_ellipsoids


@pytest.fixture(scope="session")
def stored():
    return stored_ellipsoids()


@pytest.fixture(scope="session")
def prior(stored):
    return fit_prior(stored)
