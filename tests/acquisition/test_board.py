from thermacq.acquisition.board import HISTORY, Board, Cell, Order


def test_losses_are_told_by_cause() -> None:
    board = Board(2)
    board.add(1, Cell.RING_FULL, 3)
    board.add(1, Cell.LATE_TRIGGER)
    board.add(1, Cell.RECEIVED, 50)
    assert board.losses(1) == {"late_trigger": 1, "ring_full": 3}
    assert board.losses(0) == {}
    board.close()


def test_orders_do_not_touch_cells() -> None:
    board = Board(1)
    board.give(Order.START_NS, 2**62)
    board.give(Order.STOP)
    assert board.order(Order.START_NS) == 2**62
    assert board.order(Order.GO) == 0
    assert all(board.get(0, cell) == 0 for cell in Cell)
    board.close()


def test_recent_skew_compares_equal_triggers_only() -> None:
    board = Board(2)
    assert board.recent_skew_ns(0, 1).size == 0
    for index in range(HISTORY + 10):
        board.note_trigger(0, index, 1000 * index)
        if index % 2:
            board.note_trigger(1, index, 1000 * index - 7)
    skew = board.recent_skew_ns(0, 1)
    assert skew.size == HISTORY // 2
    assert set(skew) == {7}
    board.close()
