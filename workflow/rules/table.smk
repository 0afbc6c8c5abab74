"""Errors of the tests and of the background alone: Table 1 and the largest errors."""


rule table1:
    input:
        background="results/phantom/background.tif",
        tests=expand("results/tests/{test}/displacement.tif", test=[*TESTS, *OURS]),
        truth="results/phantom/true.tif",
        code=code("table1.py"),
    output:
        errors=expand("results/tests/{test}/errors.csv", test=ROWS),
        csv="results/table1.csv",
        tex="results/table1.tex",
        html=report(
            "results/table1.html", caption="../report/table1.rst", category="Table 1"
        ),
        largest=report(
            "results/largest_errors.csv",
            caption="../report/largest_errors.rst",
            category="Table 1",
        ),
    log:
        "logs/table1.log",
    benchmark:
        "benchmarks/table1.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    params:
        tests={name: settings.variant(name).model_dump() for name in TESTS},
        ours=OURS,
    script:
        "../scripts/table1.py"
