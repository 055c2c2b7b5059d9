# fbrl with its engine, set up by scripts/setup.sh as on any other machine.
#
#   docker build -t fbrl .
#   docker run --rm -it --user "$(id -u):$(id -g)" -v "$PWD:/matches" fbrl \
#       fbrl-train academy_3_vs_1_with_keeper
#
# With CUDA's base image, for a host with NVIDIA's container toolkit (docker run --gpus all):
#
#   docker build -t fbrl:cuda --build-arg BASE=nvidia/cuda:12.8.1-base-ubuntu22.04 .
#
# Docker 23 or newer, or Podman. The compiled engine is kept in a cache of the builder, outside the
# image.
#
# BASE   any image of Debian 12 or 13, or of Ubuntu 22.04 or 24.04
# TORCH  what pip is asked for, options included: the CUDA build of PyTorch as the package index has
#        it by default; "torch==2.13.0 --index-url INDEX" takes a smaller one for CPUs
ARG BASE=debian:12-slim
FROM ${BASE}

ARG TORCH=""
ARG DEBIAN_FRONTEND=noninteractive
SHELL ["/bin/bash", "-o", "pipefail", "-c"]

# What set-up asks for before it installs all else by itself.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates make \
    && rm -rf /var/lib/apt/lists/*

COPY . /opt/fbrl
WORKDIR /opt/fbrl
RUN --mount=type=cache,target=/var/cache/fbrl \
    make setup TORCH="${TORCH}" XDG_CACHE_HOME=/var/cache/fbrl \
    && .venv/bin/python -m compileall -q -j 0 .venv/lib fbrl \
    && apt-get clean \
    && rm -rf build /var/lib/apt/lists/*

ENV PATH=/opt/fbrl/.venv/bin:${PATH} HOME=/home/player
# Whoever runs it, such as the owner of a mounted directory, can write its caches, and matches where
# nothing is mounted.
RUN useradd --uid 10001 --create-home player \
    && install -d -m 1777 /home/player /matches
USER 10001
WORKDIR /matches
CMD ["fbrl-doctor", "--no-render"]
