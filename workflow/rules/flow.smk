"""Tracked bubbles, and the displacement fields of the five tests."""


rule track:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        prediction="results/phantom/background.tif",
        code=code("track"),
    output:
        "results/bubbles.csv",
    log:
        "logs/track.log",
    benchmark:
        "benchmarks/track.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("track", settings.sample.shape),
    params:
        options=options(settings.tracking),
    shell:
        "eofm track --threads {threads} {input.reference} {input.deformed} --prediction {input.prediction}"
        " --output {output} {params.options} > {log} 2>&1"


rule estimate:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        bubbles="results/bubbles.csv",
        background=lambda wildcards: (
            "results/phantom/background.tif"
            if settings.tests[wildcards.test].background
            else []
        ),
        code=code("estimate"),
    output:
        "results/tests/{test}/displacement.tif",
    log:
        "logs/estimate/{test}.log",
    benchmark:
        "benchmarks/estimate/{test}.tsv"
    wildcard_constraints:
        test="|".join(TESTS),
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("estimate", settings.sample.shape),
    params:
        options=lambda wildcards: options(settings.variant(wildcards.test)),
        background=lambda wildcards, input: (
            f"--background {input.background}" if input.background else ""
        ),
    shell:
        "eofm estimate --threads {threads} {input.reference} {input.deformed} --bubbles {input.bubbles}"
        " {params.background} --output {output} {params.options} > {log} 2>&1 || [ $? -eq 3 ]"
