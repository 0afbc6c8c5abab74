"""Time, memory and error of several tools on volumes, and the cases that al-dvc publishes."""

# Motions of al-dvc's accuracy, on which it and the preset are run.
PUBLISHED = ["affine", "noise", "sinusoid"]
MEASURED_VOLUMES = [
    f"{tool}-speckle-{size}"
    for tool, largest in settings.benchmark_volume.largest.items()
    for size in settings.benchmark_volume.sizes
    if size <= largest
] + [
    f"{tool}-{case}-{settings.benchmark_volume.cases}"
    for tool in settings.benchmark_volume.largest
    for case in PUBLISHED
    if tool in ("eofm_preset", "aldvc")
]


rule benchmark_volume:
    input:
        f"{BENCHMARK}/volume.csv",


rule benchmark_volume_pair:
    input:
        code=code("benchmark_volume_pair.py"),
    output:
        reference=f"{BENCHMARK}/volume/{{case}}-{{size}}/reference.tif",
        deformed=f"{BENCHMARK}/volume/{{case}}-{{size}}/deformed.tif",
        truth=f"{BENCHMARK}/volume/{{case}}-{{size}}/true.tif",
    log:
        "logs/benchmark_volume/{case}-{size}.log",
    benchmark:
        "benchmarks/benchmark_volume/{case}-{size}.tsv"
    wildcard_constraints:
        case="|".join(["speckle", *PUBLISHED]),
        size=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=4000,
    params:
        seed=settings.benchmark_volume.seed,
    script:
        "../scripts/benchmark_volume_pair.py"


rule benchmark_volume_estimate:
    input:
        reference=f"{BENCHMARK}/volume/{{case}}-{{size}}/reference.tif",
        deformed=f"{BENCHMARK}/volume/{{case}}-{{size}}/deformed.tif",
        truth=f"{BENCHMARK}/volume/{{case}}-{{size}}/true.tif",
        code=code("benchmark_volume_estimate.py"),
    output:
        f"{BENCHMARK}/volume/{{tool}}-{{case}}-{{size}}.csv",
    log:
        "logs/benchmark_volume/{tool}-{case}-{size}.log",
    benchmark:
        "benchmarks/benchmark_volume/{tool}-{case}-{size}.tsv"
    wildcard_constraints:
        tool="|".join(settings.benchmark_volume.largest),
        case="|".join(["speckle", *PUBLISHED]),
        size=r"\d+",
    conda:
        "../envs/eofm.yaml"
    threads: workflow.cores
    resources:
        mem_mb=8000,
    params:
        eofm=IMAGES_ONLY.model_dump(),
        eofm_preset=settings.preset.changed(zero_edges=(), limits=None).model_dump(),
    script:
        "../scripts/benchmark_volume_estimate.py"


rule benchmark_volume_table:
    input:
        expand("{folder}/volume/{run}.csv", folder=BENCHMARK, run=MEASURED_VOLUMES),
    output:
        report(
            f"{BENCHMARK}/volume.csv",
            caption="../report/benchmark_volume.rst",
            category="Benchmark",
        ),
    log:
        "logs/benchmark_volume/table.log",
    benchmark:
        "benchmarks/benchmark_volume/table.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    shell:
        "awk 'FNR > 1 || NR == 1' {input} > {output} 2> {log}"
