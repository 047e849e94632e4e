import pytest

from thermacq.acquisition.shared import SharedBlock
from thermacq.errors import AcquisitionError


def test_two_mappings_share_one_memory_that_outlives_the_handle() -> None:
    block = SharedBlock()
    block.allocate(4096)
    one, other = block.map(), block.map()
    block.close()
    one[:3] = b"abc"
    assert other[:3] == b"abc"


def test_too_large_a_block_is_refused_before_it_is_used() -> None:
    block = SharedBlock()
    with pytest.raises(AcquisitionError, match="no room in memory"):
        block.allocate(2**62)
    block.close()
