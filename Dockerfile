# docker build -t dslam . && docker run --rm -v "$PWD:/data" dslam replay drive.mcap -o map.mcap
FROM python:3.11-slim
WORKDIR /source
COPY . .
# The CPU build of torch first: the one that pip takes by default brings CUDA, which nothing here needs.
RUN pip install --no-cache-dir --index-url https://download.pytorch.org/whl/cpu "torch>=2.5" \
 && pip install --no-cache-dir . \
 && rm -rf /source/*
WORKDIR /data
ENTRYPOINT ["dslam"]
