"""Measured numbers that the texts quote: `make numbers` puts them there."""

QUOTED = "docs/figures"


rule numbers:
    input:
        expand(
            "{folder}/{name}.json",
            folder=QUOTED,
            name=["paper", "ensemble", "benchmark", "studies"],
        ),


rule numbers_paper:
    input:
        table="results/table1.csv",
        largest="results/largest_errors.csv",
        bubbles="results/bubbles.csv",
        truth="results/phantom/true.tif",
        background="results/phantom/background.tif",
        virtual_oct="results/virtual_oct/errors.csv",
        code=code("numbers_paper.py"),
    output:
        f"{QUOTED}/paper.json",
    log:
        "logs/numbers/paper.log",
    benchmark:
        "benchmarks/numbers/paper.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        config=settings.model_dump(mode="json"),
        command="snakemake --cores 2 docs/figures/paper.json",
    script:
        "../scripts/numbers_paper.py"


rule numbers_ensemble:
    input:
        table="results/ensemble/test6.csv",
        code=code("numbers_ensemble.py"),
    output:
        f"{QUOTED}/ensemble.json",
    log:
        "logs/numbers/ensemble.log",
    benchmark:
        "benchmarks/numbers/ensemble.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    params:
        name="ensemble",
        command="snakemake --cores 2 docs/figures/ensemble.json",
    script:
        "../scripts/numbers_ensemble.py"


use rule numbers_ensemble as numbers_benchmark with:
    input:
        table="results/benchmark/estimate.csv",
        solver="results/benchmark/solver.csv",
        code=code("numbers_ensemble.py"),
    output:
        f"{QUOTED}/benchmark.json",
    log:
        "logs/numbers/benchmark.log",
    benchmark:
        "benchmarks/numbers/benchmark.tsv"
    params:
        name="benchmark",
        command="snakemake --cores 2 docs/figures/benchmark.json",


rule numbers_studies:
    input:
        studies=expand("{folder}/{name}.json", folder=STUDIES, name=STUDY_PARTS),
        code=code("numbers_studies.py"),
    output:
        f"{QUOTED}/studies.json",
    log:
        "logs/numbers/studies.log",
    benchmark:
        "benchmarks/numbers/studies.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    params:
        command="snakemake --cores 2 docs/figures/studies.json",
    script:
        "../scripts/numbers_studies.py"


# No part of `numbers`: the pairs take more than an hour on two cores.
rule numbers_robustness:
    input:
        table=f"{ROBUSTNESS}/errors.csv",
        code=code("numbers_robustness.py"),
    output:
        f"{QUOTED}/robustness.json",
    log:
        "logs/numbers/robustness.log",
    benchmark:
        "benchmarks/numbers/robustness.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    params:
        command="snakemake --cores 2 docs/figures/robustness.json",
    script:
        "../scripts/numbers_robustness.py"


# No part of `numbers`: the volumes take half an hour on two cores.
rule numbers_volume:
    input:
        errors=f"{VOLUME}/errors.csv",
        benchmark=f"{BENCHMARK}/volume.csv",
        code=code("numbers_volume.py"),
    output:
        f"{QUOTED}/volume.json",
    log:
        "logs/numbers/volume.log",
    benchmark:
        "benchmarks/numbers/volume.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    params:
        command="snakemake --cores 2 docs/figures/volume.json",
    script:
        "../scripts/numbers_volume.py"
