"""A cluster of processes that were started apart: TLS, a worker killed, the scheduler restarted."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from astropy.io import fits

from scope_models.batch import read_results, simulate_table

STARS = 500
CONFIG = {
    "distributed": {
        "comm": {
            "require-encryption": True,
            "tls": {"ca-file": "cert.pem"}
            | {
                who: {"cert": "cert.pem", "key": "key.pem"}
                for who in ("scheduler", "worker", "client")
            },
        }
    }
}


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def certify(folder):
    """Write a key, its certificate, and Dask's configuration with both."""
    import datetime as dt

    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "of one run")])
    now = dt.datetime.now(dt.UTC)
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name)
    builder = builder.public_key(key.public_key()).serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(now - dt.timedelta(hours=1))
    certificate = builder.not_valid_after(now + dt.timedelta(days=1)).sign(key, hashes.SHA256())
    pem = serialization.Encoding.PEM
    (folder / "cert.pem").write_bytes(certificate.public_bytes(pem))
    private = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (folder / "key.pem").write_bytes(key.private_bytes(pem, *private))
    (folder / "dask.yaml").write_text(json.dumps(CONFIG))  # JSON is YAML


@contextmanager
def started(folder, *processes):
    """Start processes in sessions of their own, and end them."""
    environment = os.environ | {"DASK_CONFIG": str(folder / "dask.yaml")}
    running = []
    try:
        for number, command in enumerate(processes):
            with (folder / f"log{number}.txt").open("wb") as log:
                running.append(
                    subprocess.Popen(
                        [sys.executable, "-m", *command], cwd=folder, env=environment,
                        stdout=log, stderr=log, start_new_session=True,
                    )
                )  # fmt: skip
        yield running
    finally:
        for process in running:
            kill(process)


def kill(process):
    """Kill a process and its children."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def cluster(folder, port, workers):
    """Start a scheduler and workers on the loopback."""
    address = f"tls://127.0.0.1:{port}"
    scheduler = ["dask", "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard",
                 "--protocol", "tls"]  # fmt: skip
    worker = ["dask", "worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--nworkers",
              "1", "--memory-limit", "1GiB", "--no-dashboard", "--death-timeout", "60"]  # fmt: skip
    return started(folder, scheduler, *[worker] * workers)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills groups of processes")
def test_a_worker_is_killed_and_the_scheduler_restarted(tmp_path):
    """Each star is there once and complete, and finished stars are not computed again."""
    certify(tmp_path)
    stars = {
        "name": [f"s{n:03d}" for n in range(STARS)],
        "mag": [11 + n / 125 for n in range(STARS)],
    }
    simulate_table(stars, tmp_path / "pixels", cadences=300, sweep={"progress": False})
    port, out = free_port(), tmp_path / "corrected"
    code = "import sys; from scope_models.cli import main; sys.exit(main())"
    command = [
        sys.executable, "-c", code, "detrend",
        *sorted(str(path) for path in (tmp_path / "pixels").glob("*.fits")),
        "--output-dir", str(out), "--order", "1", "--scheduler", f"tls://127.0.0.1:{port}",
    ]  # fmt: skip
    environment = os.environ | {"DASK_CONFIG": str(tmp_path / "dask.yaml")}
    options = {"cwd": tmp_path, "env": environment, "text": True, "stderr": subprocess.PIPE}

    def wait_for(number, run):
        limit = time.monotonic() + 600
        while len(list(out.glob("*-lc.fits"))) < number:
            assert run.poll() is None
            assert time.monotonic() < limit
            time.sleep(0.05)

    with cluster(tmp_path, port, 3) as (scheduler, *workers):
        run = subprocess.Popen(command, **options)
        wait_for(50, run)
        kill(workers[0])  # the others go on with its stars
        wait_for(200, run)
        kill(scheduler)
        _, message = run.communicate(timeout=200)
        assert run.returncode == 1
        assert "the same call goes on from there" in message
    before = {path: path.stat().st_mtime_ns for path in out.glob("*-lc.fits")}
    finished = set(read_results(out)["output"])
    assert 150 < len(finished) < STARS
    with cluster(tmp_path, port, 2):
        run = subprocess.run(command, timeout=900, check=False, **options)
        assert run.returncode == 0, run.stderr
    table = read_results(out)
    assert table["key"].tolist() == stars["name"]
    for path, changed in before.items():
        assert path.name not in finished or path.stat().st_mtime_ns == changed
    for name in table["output"]:
        with fits.open(out / name, checksum=True) as hdus:  # a wrong checksum warns
            hdus.verify("exception")
            assert len(hdus[1].data) > 250
    assert sorted(path.name for path in out.glob("*.fits")) == sorted(table["output"])
    # a process that is killed leaves what it was writing, which the next run removes
    assert not list(out.glob(".scope-models*"))
    assert (table["seconds"].value < 60).all()
    assert (table["peak_memory"].value < 1024).all()
