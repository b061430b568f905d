"""The containers, for real: the image is built and the compose file brought up with podman, without any registry.

No image is pulled. The base is made by debootstrap; PostgreSQL, NATS and Prometheus come from Debian's packages,
each under the name that the compose file gives; Grafana, which Debian lacks, is left out. As root, with podman,
runc, netavark, aardvark-dns, iptables, debootstrap and podman-compose; what was made is kept in --folder.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
BASE = "localhost/creak-base"
NEEDED = ("podman", "runc", "debootstrap", "iptables", "podman-compose")
PORTS = {8300: 18300, 9090: 19090}
SETTINGS = {
    "storage.conf": '[storage]\ndriver = "overlay"\nrunroot = "{folder}/run"\ngraphroot = "{folder}/graph"\n',
    "containers.conf": '[containers]\ndefault_ulimits = ["nofile=20000:20000", "nproc=32768:32768"]\n'
    '[engine]\nruntime = "runc"\n[network]\nnetwork_backend = "netavark"\n',
}
STAND_INS = f"""
FROM {BASE} AS all
RUN apt-get update -q && apt-get install -y -q --no-install-recommends postgresql nats-server prometheus
FROM all AS postgres
COPY --chmod=755 postgres.sh /entry
ENTRYPOINT ["/entry"]
FROM all AS nats
ENTRYPOINT ["nats-server"]
FROM all AS prometheus
RUN install --directory --owner nobody /prometheus
USER nobody
ENTRYPOINT ["prometheus", "--config.file=/etc/prometheus/prometheus.yml", "--storage.tsdb.path=/prometheus"]
"""
POSTGRES = """#!/bin/sh
# What the official image does with an empty volume, in short.
set -e
as="setpriv --reuid postgres --regid postgres --clear-groups $(dirname /usr/lib/postgresql/*/bin/initdb)"
data=/var/lib/postgresql/data
ln -sf /usr/lib/postgresql/*/bin/pg_isready /usr/local/bin/
chown postgres $data
if [ ! -s $data/PG_VERSION ]; then
    echo "$POSTGRES_PASSWORD" > /tmp/word && chown postgres /tmp/word
    $as/initdb -D $data --auth-host scram-sha-256 --encoding UTF8 --locale C.UTF-8 \\
        --username "$POSTGRES_USER" --pwfile /tmp/word
    echo "host all all all scram-sha-256" >> $data/pg_hba.conf
    $as/pg_ctl -D $data -w start
    $as/createdb --username "$POSTGRES_USER" "$POSTGRES_USER"
    $as/pg_ctl -D $data -w stop
fi
exec $as/postgres -D $data -c listen_addresses='*'
"""


class Engine:
    """podman with a store of its own, and the compose file on ports of its own."""

    def __init__(self, folder):
        self.folder = folder
        for name, text in SETTINGS.items():
            (folder / name).write_text(text.format(folder=folder))
        self.environment = os.environ | {
            "CONTAINERS_STORAGE_CONF": str(folder / "storage.conf"),
            "CONTAINERS_CONF": str(folder / "containers.conf"),
            "BUILDAH_FORMAT": "docker",  # else the health check is dropped
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        }

    def __call__(self, *command, check=True, cwd=None):
        done = subprocess.run(
            [*map(str, command)], env=self.environment, cwd=cwd, capture_output=True, text=True, check=False
        )
        if check and done.returncode:
            raise SystemExit(f"{' '.join(map(str, command))}: {done.stdout[-2000:]}{done.stderr[-3000:]}")
        return done

    def has(self, image):
        return self("podman", "image", "exists", image, check=False).returncode == 0

    def compose(self, *command):
        """What podman-compose says; its own errors are told by what then does not come up."""
        return self(
            "podman-compose", "--file", self.folder / "compose.yml", "--project-name", "creakbench", *command
        )

    def run(self, service, *command):
        return self("podman", "exec", f"creakbench_{service}_1", *command).stdout.strip()


def make_base(engine):
    """Debian with Python, with this machine's certificates and pip's settings."""
    root = engine.folder / "base"
    engine(
        *("debootstrap", "--variant=minbase", "--include=ca-certificates,netbase,python3,python3-venv"),
        *("bookworm", root, "http://deb.debian.org/debian"),
    )
    shutil.copy("/etc/ssl/certs/ca-certificates.crt", root / "etc/ssl/certs/ca-certificates.crt")
    (root / "etc/pip.conf").write_text("[global]\ncert = /etc/ssl/certs/ca-certificates.crt\ntimeout = 180\n")
    engine("sh", "-c", f"tar -C {root} -c . | podman import - {BASE}")
    shutil.rmtree(root)


def make_stand_ins(engine, services):
    """Images for what would come from a registry, under the names that the compose file has."""
    folder = engine.folder / "stand-ins"
    folder.mkdir(exist_ok=True)
    (folder / "Containerfile").write_text(STAND_INS)
    (folder / "postgres.sh").write_text(POSTGRES)
    for name in ("postgres", "nats", "prometheus"):
        if not engine.has(services[name]["image"]):
            engine("podman", "build", "--target", name, "--tag", services[name]["image"], folder)


def write_compose(engine):
    """The compose file as it is, but for the ports, Grafana, the base image, and conditions that need systemd."""
    file = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    services = file["services"]
    del services["grafana"]
    for service in services.values():
        service.pop("depends_on", None)
        service["ports"] = [
            f"127.0.0.1:{PORTS[int(port.rpartition(':')[2])]}:{port.rpartition(':')[2]}"
            for port in service.get("ports", [])
        ]
        service["volumes"] = [
            str(ROOT / volume) if volume.startswith(".") else volume for volume in service.get("volumes", [])
        ]
        if "build" in service:
            service["build"] = {"context": str(ROOT), "dockerfile": "deploy/Dockerfile", "args": {"BASE": BASE}}
    (engine.folder / "compose.yml").write_text(yaml.safe_dump(file))
    return services


def asked(port, path, key=""):
    """Status and body of an answer; 0 where there is none."""
    request = urllib.request.Request(f"http://127.0.0.1:{PORTS[port]}{path}")
    if key:
        request.add_header("Authorization", f"Bearer {key}")
    try:
        with urllib.request.urlopen(request, timeout=5) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()
    except OSError:
        return 0, ""


def waited(what, until, seconds=180):
    """Seconds that it took until something was true."""
    begun = time.monotonic()
    while not until():
        if time.monotonic() - begun > seconds:
            raise SystemExit(f"timed out: {what}")
        time.sleep(0.2)
    return round(time.monotonic() - begun, 1)


def bring_up(engine):
    """Start everything in the order of the compose file's conditions; what was seen."""
    seen = {}
    begun = time.monotonic()
    engine.compose("up", "--detach", "--no-build", "postgres", "nats")
    healthy = ("podman", "healthcheck", "run", "creakbench_postgres_1")
    waited("PostgreSQL", lambda: engine(*healthy, check=False).returncode == 0)
    engine.compose("up", "--detach", "--no-build", "creak")
    waited("the API", lambda: asked(8300, "/healthz")[0] == 200)
    seen["seconds until it answers"] = round(time.monotonic() - begun, 1)
    engine.compose("up", "--no-build", "key")
    engine.compose("up", "--detach", "--no-build", "prometheus")
    key = engine.run("prometheus", "cat", "/run/creak/key")
    seen["without a key"] = asked(8300, "/api/v1/rigs")[0]
    seen["health check"] = (
        engine("podman", "healthcheck", "run", "creakbench_creak_1", check=False).returncode == 0
    )
    seen["user"] = engine.run("creak", "id", "-un")
    seen["root is read-only"] = (
        engine("podman", "exec", "creakbench_creak_1", "touch", "/x", check=False).returncode != 0
    )

    def levels():
        status, body = asked(8300, "/api/v1/rigs/beam/nodes", key)
        return status == 200 and json.loads(body)["items"][0]["signal_db"] is not None

    def scraped():
        body = asked(9090, "/api/v1/query?query=creak_run_running")[1]
        return bool(body) and [row["value"][1] for row in json.loads(body)["data"]["result"]] == ["1"]

    seen["seconds until Prometheus has its figures"] = waited("Prometheus", scraped)
    rules = json.loads(asked(9090, "/api/v1/rules")[1])["data"]["groups"][0]["rules"]
    seen["alert rules loaded"] = len(rules)
    seen["alerts firing"] = sum(rule["state"] == "firing" for rule in rules)
    runs = "psql --username creak --dbname creak --tuples-only --command 'select count(*) from runs'"
    seen["runs in PostgreSQL"] = int(engine.run("postgres", "sh", "-c", runs))
    seen["NATS JetStream"] = '"config"' in engine.run(
        "creak", "python3", "-c", "import urllib.request as u; print(u.urlopen('http://nats:8222/jsz').read())"
    )
    seen["seconds until there are levels"] = waited("levels", levels, 400)
    begun = time.monotonic()
    engine("podman", "stop", "--time", "10", "creakbench_creak_1")
    seen["seconds to stop"] = round(time.monotonic() - begun, 1)
    return seen


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("/var/tmp/creak-containers"), help="for images")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    missing = [
        name
        for name in NEEDED
        if not shutil.which(name, path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    ]
    if missing or os.geteuid() != 0:
        raise SystemExit(f"needs root, and {', '.join(missing or NEEDED)}")
    options.folder.mkdir(parents=True, exist_ok=True)
    engine = Engine(options.folder)
    services = write_compose(engine)
    if not engine.has(BASE):
        make_base(engine)
    make_stand_ins(engine, services)
    begun = time.monotonic()
    engine.compose("build", "creak")
    result = {"seconds to build": round(time.monotonic() - begun, 1)}
    sizes = [
        int(engine("podman", "image", "inspect", "--format", "{{.Size}}", name).stdout) for name in ("creak", BASE)
    ]
    result["image, MB, beyond its base"] = round((sizes[0] - sizes[1]) / 1e6)
    try:
        result |= bring_up(engine)
    except SystemExit:
        print(engine.compose("logs", "--tail", "30").stdout, file=sys.stderr)
        raise
    finally:
        engine.compose("down", "--volumes")
    print(json.dumps(result, indent=None if options.json else 1))


if __name__ == "__main__":
    main()
