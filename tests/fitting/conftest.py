import pytest
from fitting_cases import stored_ellipsoids

from ostiform.fitting import fit_prior


@pytest.fixture(scope="session")
def stored():
    return stored_ellipsoids()


@pytest.fixture(scope="session")
def prior(stored):
    return fit_prior(stored)
