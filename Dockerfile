# docker build -t dslam . && docker run --rm -v "$PWD:/data" dslam replay drive.mcap -o map.mcap
FROM python:3.11-slim
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir '.[pictures]' && rm -rf /source/*
WORKDIR /data
ENTRYPOINT ["dslam"]
