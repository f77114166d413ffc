"""Messages between processes: equal values, arrays that can be changed, and closed ends."""

import socket
from threading import Thread

import numpy as np
import pytest

from surveysim.runtime.messages import receive, send


def test_values_arrive_as_they_were_sent():
    ours, theirs = socket.socketpair()
    arrays = [np.arange(2e6).reshape(4, -1), np.zeros((3, 0)), np.asfortranarray(np.eye(3)), np.arange(9)[::2]]
    sender = Thread(target=lambda: [send(ours, ("text", arrays)), send(ours, None)])
    sender.start()
    text, found = receive(theirs)
    assert receive(theirs) is None
    sender.join()
    assert text == "text"
    for one, other in zip(found, arrays, strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
        one += 1  # a copy of its own
    ours.close(), theirs.close()


def test_a_closed_end_is_an_error_and_no_value():
    ours, theirs = socket.socketpair()
    ours.sendall(b"\x02")
    ours.close()
    with pytest.raises(EOFError):
        receive(theirs)
    theirs.close()
