# One image for the Ray head, the Ray workers and the API: every node runs the same versions.
FROM python:3.11-slim

ENV PIP_NO_CACHE_DIR=1 \
    PYTHONUNBUFFERED=1 \
    RAY_USAGE_STATS_ENABLED=0 \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1 \
    MKL_NUM_THREADS=1 \
    MUJOCO_GL=egl

# wget: KubeRay asks by it whether a node lives
RUN apt-get update \
 && apt-get install --yes --no-install-recommends libegl1 libgl1 libgl1-mesa-dri wget \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --create-home --uid 1000 adr \
 && mkdir /data && chown adr /data

WORKDIR /app
COPY constraints.txt ./
# The CPU build of PyTorch; the default index would pull gigabytes of CUDA.
RUN pip install --constraint constraints.txt --extra-index-url https://download.pytorch.org/whl/cpu torch==2.13.0
COPY pyproject.toml README.md LICENSE ./
COPY adr_service adr_service
COPY workers workers
COPY db db
COPY api api
RUN pip install --constraint constraints.txt ".[fast,postgresql,sbi]"

USER adr
ENV ADR_DATA_DIR=/data
EXPOSE 8000 8265
# 127.0.0.1 would be the container's own; this address demands ADR_TOKEN
CMD ["adr", "serve", "--host", "0.0.0.0"]
