"""Errors of the tests and of the background alone, and Table 1."""


rule evaluate:
    input:
        estimate=lambda wildcards: (
            "results/phantom/background.tif"
            if wildcards.test == "background"
            else "results/tests/{test}/displacement.tif"
        ),
        truth="results/phantom/true.tif",
        code=code("metrics"),
    output:
        "results/tests/{test}/errors.csv",
    log:
        "logs/evaluate/{test}.log",
    benchmark:
        "benchmarks/evaluate/{test}.tsv"
    wildcard_constraints:
        test="|".join(ROWS),
    resources:
        mem_mb=300,
    shell:
        "eofm evaluate {input.estimate} {input.truth} --output {output} > {log} 2>&1"


rule table1:
    input:
        errors=expand("results/tests/{test}/errors.csv", test=ROWS),
    output:
        csv="results/table1.csv",
        tex="results/table1.tex",
        html=report(
            "results/table1.html", caption="../report/table1.rst", category="Table 1"
        ),
    log:
        "logs/table1.log",
    benchmark:
        "benchmarks/table1.tsv"
    resources:
        mem_mb=300,
    params:
        tests={name: settings.variant(name).model_dump() for name in TESTS},
        ours=OURS,
    script:
        "../scripts/table1.py"
