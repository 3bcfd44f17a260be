# The dashboard and all commands, for any user, without a home and on a read-only file system:
# docs/serving.md. Debian's Chromium draws for `dbb screenshot` and `dbb film`.
FROM python:3.12-slim-bookworm
RUN apt-get update \
    && apt-get install -y --no-install-recommends chromium libegl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
COPY . /src
RUN pip install --no-cache-dir --require-hashes -r /src/requirements/all.txt \
    && pip install --no-cache-dir --no-deps /src \
    && rm -rf /src
# Kernels are compiled here, for every machine of this architecture, and read by every user. Every
# user can write into /data, also after Docker has created a volume for it.
ENV NUMBA_CPU_NAME=generic
RUN python -c 'import app.simulation.session' && install -d -m 1777 /data
USER nobody
EXPOSE 8080
ENTRYPOINT ["dbb"]
CMD ["serve", "--host", "0.0.0.0"]
