"""Time, memory and error of several tools by size, and the solver's iterations.

Each measurement has a process of its own and all cores of the run, so that no other job
runs beside it; it uses one of them.
"""

BENCHMARK = "results/benchmark"
REGULARISERS = ["gradient", "bending"]
MEASURED = [
    f"{tool}-{size}"
    for tool, largest in settings.benchmark.largest.items()
    for size in settings.benchmark.sizes
    if size <= largest
]


rule benchmark:
    input:
        expand(
            "{folder}/{name}",
            folder=BENCHMARK,
            name=["estimate.csv", "solver.csv", "benchmark.png", "benchmark.pdf"],
        ),


rule benchmark_pair:
    input:
        code=code("benchmark_pair.py"),
    output:
        reference=f"{BENCHMARK}/{{image}}-{{size}}/reference.tif",
        deformed=f"{BENCHMARK}/{{image}}-{{size}}/deformed.tif",
        truth=f"{BENCHMARK}/{{image}}-{{size}}/true.tif",
    log:
        "logs/benchmark/{image}-{size}.log",
    benchmark:
        "benchmarks/benchmark/{image}-{size}.tsv"
    wildcard_constraints:
        image="dense|sparse",
        size=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=2000,
    params:
        phantom=settings.phantom.model_dump(),
        seed=settings.benchmark.seed,
    script:
        "../scripts/benchmark_pair.py"


rule benchmark_estimate:
    input:
        reference=f"{BENCHMARK}/dense-{{size}}/reference.tif",
        deformed=f"{BENCHMARK}/dense-{{size}}/deformed.tif",
        truth=f"{BENCHMARK}/dense-{{size}}/true.tif",
        code=code("benchmark_estimate.py"),
    output:
        f"{BENCHMARK}/estimate/{{tool}}-{{size}}.csv",
    log:
        "logs/benchmark/estimate/{tool}-{size}.log",
    benchmark:
        "benchmarks/benchmark/estimate/{tool}-{size}.tsv"
    wildcard_constraints:
        tool="|".join(settings.benchmark.largest),
        size=r"\d+",
    conda:
        "../envs/eofm.yaml"
    threads: workflow.cores
    resources:
        mem_mb=6000,
    params:
        eofm=IMAGES_ONLY.model_dump(),
        eofm_preset=settings.preset.changed(zero_edges=()).model_dump(),
    script:
        "../scripts/benchmark_estimate.py"


rule benchmark_solver:
    input:
        reference=f"{BENCHMARK}/{{image}}-{{size}}/reference.tif",
        deformed=f"{BENCHMARK}/{{image}}-{{size}}/deformed.tif",
        code=code("benchmark_solver.py"),
    output:
        f"{BENCHMARK}/solver/{{regulariser}}-{{image}}-{{size}}.csv",
    log:
        "logs/benchmark/solver/{regulariser}-{image}-{size}.log",
    benchmark:
        "benchmarks/benchmark/solver/{regulariser}-{image}-{size}.tsv"
    wildcard_constraints:
        regulariser="|".join(REGULARISERS),
        image="dense|sparse",
        size=r"\d+",
    conda:
        "../envs/eofm.yaml"
    threads: workflow.cores
    resources:
        mem_mb=6000,
    params:
        alphas=settings.benchmark.alphas,
    script:
        "../scripts/benchmark_solver.py"


rule benchmark_tables:
    input:
        estimate=expand("{folder}/estimate/{run}.csv", folder=BENCHMARK, run=MEASURED),
        solver=expand(
            "{folder}/solver/{regulariser}-{image}-{size}.csv",
            folder=BENCHMARK,
            regulariser=REGULARISERS,
            image=["dense", "sparse"],
            size=settings.benchmark.sizes,
        ),
        code=code("benchmark.py"),
    output:
        estimate=report(
            f"{BENCHMARK}/estimate.csv",
            caption="../report/benchmark.rst",
            category="Benchmark",
        ),
        solver=report(
            f"{BENCHMARK}/solver.csv",
            caption="../report/benchmark.rst",
            category="Benchmark",
        ),
        png=report(
            f"{BENCHMARK}/benchmark.png",
            caption="../report/benchmark.rst",
            category="Benchmark",
        ),
        pdf=f"{BENCHMARK}/benchmark.pdf",
    log:
        "logs/benchmark/tables.log",
    benchmark:
        "benchmarks/benchmark/tables.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump(),
    script:
        "../scripts/benchmark.py"
