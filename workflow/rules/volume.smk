"""The same experiment in three dimensions: a pressed box with a sphere, and what is found of it."""

VOLUME = "results/volume"
IMAGES = {"bubbles": settings.volume.bubbles, "speckle": settings.volume.speckle}
# Test 5 and the preset. Dense speckle is brighter than 1, so grey values are not stated.
ESTIMATES = {
    "test5": settings.estimation.changed(limits=None),
    "preset": settings.preset.changed(limits=None),
}


rule volume:
    input:
        f"{VOLUME}/errors.csv",
        expand(
            "{folder}/{images}.{kind}",
            folder=VOLUME,
            images=IMAGES,
            kind=["png", "pdf"],
        ),


use rule true_field as volume_true_field with:
    output:
        f"{VOLUME}/true.tif",
    log:
        "logs/volume/true_field.log",
    benchmark:
        "benchmarks/volume/true_field.tsv"
    resources:
        mem_mb=2000,
    params:
        options=options(settings.volume.sample, settings.forward),


use rule background_field as volume_background_field with:
    output:
        f"{VOLUME}/background.tif",
    log:
        "logs/volume/background_field.log",
    benchmark:
        "benchmarks/volume/background_field.tsv"
    resources:
        mem_mb=2000,
    params:
        options=options(settings.volume.sample, settings.forward),


use rule phantom as volume_phantom with:
    input:
        displacement=f"{VOLUME}/true.tif",
        code=code("phantom"),
    output:
        reference=f"{VOLUME}/{{images}}/reference.tif",
        deformed=f"{VOLUME}/{{images}}/deformed.tif",
        table=f"{VOLUME}/{{images}}/true_bubbles.csv",
    log:
        "logs/volume/{images}/phantom.log",
    benchmark:
        "benchmarks/volume/{images}/phantom.tsv"
    wildcard_constraints:
        images="|".join(IMAGES),
    resources:
        mem_mb=2000,
    params:
        options=lambda wildcards: options(IMAGES[wildcards.images]),


use rule track as volume_track with:
    input:
        reference=f"{VOLUME}/{{images}}/reference.tif",
        deformed=f"{VOLUME}/{{images}}/deformed.tif",
        prediction=f"{VOLUME}/background.tif",
        code=code("track"),
    output:
        f"{VOLUME}/{{images}}/bubbles.csv",
    log:
        "logs/volume/{images}/track.log",
    benchmark:
        "benchmarks/volume/{images}/track.tsv"
    wildcard_constraints:
        images="|".join(IMAGES),
    resources:
        mem_mb=2000,


use rule preset as volume_estimate with:
    input:
        reference=f"{VOLUME}/{{images}}/reference.tif",
        deformed=f"{VOLUME}/{{images}}/deformed.tif",
        bubbles=f"{VOLUME}/{{images}}/bubbles.csv",
        background=f"{VOLUME}/background.tif",
        code=code("estimate"),
    output:
        displacement=f"{VOLUME}/{{images}}/{{method}}/displacement.tif",
        deviation=f"{VOLUME}/{{images}}/{{method}}/deviation.tif",
    log:
        "logs/volume/{images}/{method}.log",
    benchmark:
        "benchmarks/volume/{images}/{method}.tsv"
    wildcard_constraints:
        images="|".join(IMAGES),
        method="|".join(ESTIMATES),
    resources:
        mem_mb=2000,
    params:
        options=lambda wildcards: options(ESTIMATES[wildcards.method]),


rule volume_report:
    input:
        truth=f"{VOLUME}/true.tif",
        background=f"{VOLUME}/background.tif",
        estimates=expand(
            "{folder}/{images}/{method}/{field}.tif",
            folder=VOLUME,
            images=IMAGES,
            method=ESTIMATES,
            field=["displacement", "deviation"],
        ),
        code=code("volume.py"),
    output:
        errors=report(
            f"{VOLUME}/errors.csv",
            caption="../report/volume.rst",
            category="Volumes",
        ),
        bubbles=report(
            f"{VOLUME}/bubbles.png",
            caption="../report/volume.rst",
            category="Volumes",
        ),
        speckle=report(
            f"{VOLUME}/speckle.png",
            caption="../report/volume.rst",
            category="Volumes",
        ),
        pdf=expand("{folder}/{images}.pdf", folder=VOLUME, images=IMAGES),
    log:
        "logs/volume/report.log",
    benchmark:
        "benchmarks/volume/report.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        figures=settings.figures.model_dump(),
        methods=list(ESTIMATES),
    script:
        "../scripts/volume.py"
