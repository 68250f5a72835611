# breakaway in a container: `serve` and `simulate` are the same image (docs/deployment.md).
FROM python:3.13-slim AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
WORKDIR /src
RUN python3 -m venv /opt/breakaway
COPY requirements.lock requirements-mqtt.lock ./
RUN /opt/breakaway/bin/python -m pip install --require-hashes --requirement requirements.lock \
    --requirement requirements-mqtt.lock
COPY pyproject.toml README.md LICENSE ./
COPY valve valve
COPY discrepancy discrepancy
COPY estimators estimators
COPY drivers drivers
COPY simulator simulator
COPY service service
# what builds is not needed to run, and is not taken along
RUN /opt/breakaway/bin/python -m pip install --no-deps --no-build-isolation . \
 && /opt/breakaway/bin/python -m pip uninstall --yes hatchling pathspec pluggy trove-classifiers \
 && /opt/breakaway/bin/python -m pip uninstall --yes pip

FROM python:3.13-slim
ENV PATH=/opt/breakaway/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    NUMBA_CACHE_DIR=/var/cache/breakaway
RUN useradd --system --uid 10001 --home-dir /var/lib/breakaway --shell /usr/sbin/nologin breakaway \
 && install -d -o breakaway -g breakaway -m 0750 /var/lib/breakaway /var/cache/breakaway
COPY --from=build /opt/breakaway /opt/breakaway
USER breakaway
WORKDIR /var/lib/breakaway
# compiled once here; on another kind of processor it is compiled again at the first start
RUN python -c "from service.workers.warm_up import warm_up; warm_up()"
EXPOSE 8321
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8321/healthz', timeout=3)"]
ENTRYPOINT ["breakaway"]
CMD ["serve", "--config", "/etc/breakaway/plant.toml"]
