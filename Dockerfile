# A planning server: docker build -t scopt . ; deploy/README.md says how it is started.
FROM python:3.12-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml setup.py constraints.txt README.md LICENSE ./
COPY tools/backend.py tools/backend.py
COPY scopt scopt
COPY costs costs
COPY perception perception
COPY service service
RUN python -m venv /opt/scopt \
    && /opt/scopt/bin/pip install --no-cache-dir --disable-pip-version-check --constraint constraints.txt .

FROM python:3.12-slim-bookworm
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libusb-1.0-0 \
    && rm -rf /var/lib/apt/lists/* \
    && groupadd --system --gid 10001 scopt \
    && useradd --system --uid 10001 --gid scopt --create-home scopt \
    && install -d -o scopt -g scopt /var/lib/scopt /run/scopt
COPY --from=build /opt/scopt /opt/scopt
# The server's Python never writes into its own folder.
ENV PATH=/opt/scopt/bin:$PATH PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 XDG_CACHE_HOME=/var/lib/scopt/cache
USER scopt
WORKDIR /var/lib/scopt
VOLUME /var/lib/scopt
EXPOSE 50051 9464
# The socket is that of deploy/server.toml; a probe needs neither token nor TLS there.
HEALTHCHECK --interval=30s --timeout=10s --start-period=60s --retries=3 \
    CMD ["scopt", "health", "--target", "unix:/run/scopt/probe.sock"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["scopt"]
CMD ["serve", "--config", "/etc/scopt/server.toml"]
