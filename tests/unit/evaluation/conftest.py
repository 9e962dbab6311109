"""Real rooms, and tables of the scores that the paper's authors released of GPT-J."""

import pytest

from roomtables import build


@pytest.fixture(scope="session")
def matterport(shared_data):
    """The folder of 523 real rooms, their counts, and GPT-J's scores."""
    return shared_data / "matterport3d"


@pytest.fixture(scope="session")
def build_gpt_j(matterport, tmp_path_factory):
    """Builds a tables folder of GPT-J's scores and the authors' counts, without combinations."""

    def built(**options):
        folder = tmp_path_factory.mktemp("gpt-j")
        build(
            tables=folder,
            labels="mpcat40",
            counts=matterport / "mpcat40_room_object_counts.csv",
            scores=matterport / "mpcat40_gpt_j_mean_log_prob.csv",
            combinations="none",
            **options,
        )
        return folder

    return built


@pytest.fixture(scope="session")
def gpt_j_folder(build_gpt_j):
    """Such a folder with the settings of the package."""
    return build_gpt_j()
