# Image of the command `vo`, compiled beforehand:
#   docker build --tag vo .
#   docker run --rm --volume "$PWD:/data" --user "$(id -u):$(id -g)" vo run walk.mcap --output out
# For images without PyAV, whose wheel has GPL encoders: --build-arg EXTRAS=report,ros
FROM python:3.13-slim AS build
WORKDIR /src
COPY pyproject.toml hatch_build.py README.md LICENSE CHANGELOG.md constraints.txt ./
COPY configs configs
COPY vo vo
COPY data_synth data_synth
ARG EXTRAS=all
RUN python -m venv /opt/vo \
    && /opt/vo/bin/pip install --no-cache-dir --constraint constraints.txt ".[${EXTRAS}]"

FROM python:3.13-slim
COPY --from=build /opt/vo /opt/vo
ENV PATH=/opt/vo/bin:$PATH \
    NUMBA_CACHE_DIR=/opt/vo/compiled
# Compiled by root once, so that any user can load it; see docs/architecture.md, "Compiled code".
RUN mkdir -p "$NUMBA_CACHE_DIR" && vo warmup
WORKDIR /data
ENTRYPOINT ["vo"]
CMD ["--help"]
