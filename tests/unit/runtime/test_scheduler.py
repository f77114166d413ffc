"""Addresses of schedulers, and servers that are none: one line in bounded time, while requests to stop are heard."""

import os
import signal
import socket
import ssl
import subprocess
import threading
import time
from contextlib import contextmanager

import pytest
from distributed import LocalCluster

from surveysim.runtime import dask_scheduler as scheduler
from surveysim.runtime.addresses import address_of
from surveysim.runtime.dask_cluster import on_cluster
from surveysim.runtime.dask_scheduler import workers_at
from surveysim.runtime.engine import Engine, EngineError
from surveysim.runtime.items import InOrder


@pytest.mark.parametrize(
    "given, address",
    [
        ("tcp://node1:8786", "tcp://node1:8786"),
        ("tls://node1.cluster.org:8786", "tls://node1.cluster.org:8786"),
        ("node1:8786", "tcp://node1:8786"),
        ("tcp://127.0.0.1:8786", "tcp://127.0.0.1:8786"),
        ("tcp://[::1]:8786", "tcp://[::1]:8786"),
        ("[fe80::1]:8786", "tcp://[fe80::1]:8786"),
    ],
)
def test_addresses(given, address):
    assert address_of(given) == address


@pytest.mark.parametrize(
    "given",
    [
        "http://host:8786",
        "tcps://host:8786",
        "inproc://1/2/3",
        "://host:8786",
        "tcp://",
        "tcp://host",
        "tcp://:8786",
        "tcp://host:0",
        "tcp://host:-1",
        "tcp://host:65536",
        "tcp://host:99999999999999999999",
        "tcp://host:port",
        "tcp://host:8786/path",
        "tcp://host:8786?a=1",
        "tcp://user:word@host:8786",
        "tcp://[::1:8786",
        "tcp://::1:8786",
        "tcp://ho st:8786",
        "tcp://host\x1b[31m:8786",
        "host:123456",
        "tls://" + "a" * 5000,
        "nowhere.json",
        "/dev/zero",
        "/",
        "",
    ],
)
def test_no_addresses(given):
    refused(given, "scheduler: found ", "a scheduler's file is expected")


@pytest.mark.parametrize(
    "content",
    ["", "text", "[]", "{}", '{"address": 3}', '{"address": null}', '{"address": "nowhere"}', "[" * 100_000, "\xff\0"],
)
def test_no_schedulers_files(tmp_path, content):
    (tmp_path / "scheduler.json").write_text(content, encoding="latin-1")
    refused(str(tmp_path / "scheduler.json"), "scheduler: found ", "a scheduler's file is expected")


def test_a_pipe_is_no_schedulers_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    refused(str(tmp_path / "pipe"), "scheduler: found ", "neither an address nor a scheduler's file")


def refused(given, *words):
    with pytest.raises(EngineError) as caught:
        workers_at(address_of(given))
    text = str(caught.value)
    assert [word for word in words if word not in text] == [], text
    assert len(text) < 400 and text.isprintable()
    return text


@contextmanager
def server(answer):
    """The address of a server that does `answer(connection)` with whoever connects, in threads."""
    held = []

    def serve():
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            held.append(connection)
            threading.Thread(target=answer, args=(connection,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, daemon=True).start()
        try:
            yield f"127.0.0.1:{listening.getsockname()[1]}"
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            for connection in held:
                connection.close()


def stay_silent(connection):
    pass


def close_at_once(connection):
    connection.close()


def speak_http(connection):
    connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")


def speak_http_and_close(connection):
    speak_http(connection)
    connection.close()


def greet(connection):
    connection.sendall(b"SSH-2.0-OpenSSH_9.2p1\r\n")


def repeat(connection):
    with connection:
        while sent := connection.recv(4096):
            connection.sendall(sent)


def send_zeros(connection):
    connection.sendall(bytes(1 << 16))


def announce_much(connection):
    """Of a frame of 2^60 bytes, as dask announces its length."""
    connection.sendall((1).to_bytes(8, "little") + (1 << 60).to_bytes(8, "little"))


OTHERS = [
    stay_silent,
    close_at_once,
    speak_http,
    speak_http_and_close,
    greet,
    repeat,
    send_zeros,
    announce_much,
]


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(scheduler, "CONNECT_S", 0.4)


@pytest.mark.parametrize("answer", OTHERS)
def test_servers_that_are_no_schedulers(short, answer):
    begin = time.monotonic()
    with server(answer) as place:
        refused(f"tcp://{place}", f"scheduler: no scheduler answers at tcp://{place}")
        with pytest.raises(EngineError, match="no scheduler answers"):
            list(on_cluster(str, InOrder([1]), Engine("dask", scheduler=place)))
    assert time.monotonic() - begin < 2


def test_hosts_that_are_not_there(short):
    refused("tcp://127.0.0.1:9", "scheduler: no scheduler answers at tcp://127.0.0.1:9")
    refused("tcp://[::1]:9", "scheduler: no scheduler answers at tcp://[::1]:9")
    assert "\n" not in refused("tcp://no-such-host.invalid:8786", "scheduler: ", "no-such-host.invalid")
    refused(f"tcp://{'a' * 70}.invalid:8786", "scheduler: ", "aaa")


def test_certificates(short, tmp_path):
    """tls:// without certificates, with such as are not there, and with a server that has another's."""
    import dask

    refused("tls://127.0.0.1:9", "scheduler: found tls://127.0.0.1:9 and no certificates", "comm.tls.ca-file")
    keys = ("ca-file", "client.cert", "client.key")
    with dask.config.set({f"distributed.comm.tls.{key}": str(tmp_path / "nothing.pem") for key in keys}):
        refused("tls://127.0.0.1:9", "scheduler: dask's certificates can't be read")
    with dask.config.set({"distributed.comm.require-encryption": True}):
        refused("tcp://127.0.0.1:9", "tcp://127.0.0.1:9, which is not encrypted; tls://host:port is expected")
    one, other = certificate(tmp_path, "one"), certificate(tmp_path, "other")
    with server(speak_tls(one)) as place:
        keys = {"ca-file": other[0], "client.cert": other[0], "client.key": other[1]}
        with dask.config.set({f"distributed.comm.tls.{key}": str(path) for key, path in keys.items()}):
            refused(f"tls://{place}", f"no scheduler answers at tls://{place}", "certificate verify failed")
        refused(f"tcp://{place}", f"no scheduler answers at tcp://{place}")


def certificate(directory, name):
    """A self-signed certificate and its key."""
    paths = directory / f"{name}.pem", directory / f"{name}.key"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-subj", f"/CN={name}", "-days", "2", "-out", paths[0], "-keyout", paths[1]]
    subprocess.run(command, check=True, capture_output=True)
    return paths


def speak_tls(pair):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*pair)

    def answer(connection):
        try:
            context.wrap_socket(connection, server_side=True)
        except (OSError, ValueError):
            connection.close()

    return answer


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_requests_to_stop_are_heard(number):
    """While a scheduler is silent: at once, not after the limit."""

    def interrupt(*_):
        raise KeyboardInterrupt

    previous = signal.signal(number, interrupt)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), number))
    try:
        with server(stay_silent) as place:
            timer.start()
            begin = time.monotonic()
            with pytest.raises(KeyboardInterrupt):
                workers_at(f"tcp://{place}")
            assert time.monotonic() - begin < 2
    finally:
        signal.signal(number, previous)


@pytest.fixture(scope="module")
def cluster():
    """A scheduler without a worker."""
    with LocalCluster(n_workers=0, dashboard_address=None, silence_logs=50) as found:
        yield found


def test_no_worker(cluster, monkeypatch, caplog):
    """A line at once and again, an end after a time."""
    for name, seconds in (("LOOK_S", 0.1), ("SAY_EVERY_S", 0.2), ("WAIT_S", 0.7)):
        monkeypatch.setattr(f"surveysim.runtime.dask_cluster.{name}", seconds)
    address = cluster.scheduler_address
    assert workers_at(address) == 0
    with pytest.raises(EngineError, match="the cluster has had no worker for 1 s"):
        list(on_cluster(str, InOrder([1]), Engine("dask", scheduler=address)))
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) >= 2 and all("the cluster has no worker; waiting for one, for" in line for line in lines)


def test_another_version_of_dask(cluster, monkeypatch):
    monkeypatch.setattr("distributed.__version__", "2020.1.0")
    refused(cluster.scheduler_address, "scheduler: found distributed ", "; 2020.1.0, the version here, is expected")


def test_a_worker_is_no_scheduler(cluster):
    """Its address stands in the logs beside the scheduler's."""
    with LocalCluster(n_workers=1, processes=False, dashboard_address=None, silence_logs=50, protocol="tcp") as found:
        refused(found.workers[0].address, "scheduler: found a 'Worker' at ", "; a scheduler is expected")
