"""Options of the tests."""


def pytest_addoption(parser):
    group = parser.getgroup("surveysim")
    group.addoption("--fuzz", type=int, metavar="N", help="inputs that the slow test of mangled inputs tries")
    group.addoption("--fuzz-seed", type=int, default=1, metavar="SEED", help="seed of the mangled inputs")
    group.addoption(
        "--stress", type=int, metavar="N", help="kills that the slow stress tests try; a third as many pairs"
    )
