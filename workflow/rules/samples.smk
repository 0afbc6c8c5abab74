"""Your own image pairs, one row of the table of samples each."""

OWN = "results/samples"
PARTS = list(parts({n: row for n, row in SAMPLES.items() if "tiles" not in row}))


# Jobs that were killed say nothing themselves; their rows stand in the table all the same.
onerror:
    left = [job for job in workflow.dag.jobs if "samples_summary" in job.rule.name]
    if left and not workflow.dag.finished(left[0]):
        from samples_left import write_what_is_left

        rules_of = dict.fromkeys(SAMPLES, "gathered")
        for number, names in enumerate(PARTS):
            rules_of |= dict.fromkeys(names, f"samples_{number}")
        write_what_is_left(rules_of, Path(OWN), log)


# The last step, so that what is wrong stands at the end; the others have run by then.
rule samples:
    input:
        table=f"{OWN}/summary.csv",
        # Those that crashed are missing.
        states=expand("{folder}/{sample}/state.json", folder=OWN, sample=SAMPLES),
        script=SCRIPTS / "samples_check.py",
    log:
        "logs/samples_check.log",
    localrule: True
    conda:
        "../envs/eofm.yaml"
    shell:
        "python {input.script} {input.table} > {log} 2>&1"


for number, names in enumerate(PARTS):
    sizes = [size(SAMPLES[name]) for name in names]

    rule:
        name:
            f"samples_{number}"
        input:
            files=sorted({f for name in names for f in sample_files(SAMPLES[name])}),
            code=code("sample"),
            module=SCRIPTS / "sample_rows.py",
        output:
            # Kept while the part runs again: rows that have not changed are not computed again.
            update(expand("{folder}/{name}/state.json", folder=OWN, name=names)),
        log:
            f"logs/samples_{number}.log",
        benchmark:
            f"benchmarks/samples_{number}.tsv"
        conda:
            "../envs/eofm.yaml"
        threads: 1 if max(sizes).pixels < 1_000_000 else 4
        resources:
            mem_mb=asked_memory(sizes),
            runtime=minutes(sizes),
        params:
            folder=lambda wildcards, output: str(Path(output[0]).parents[1]),
            rows={
                name: {
                    "words": sample_words(SAMPLES[name]),
                    "files": sample_files(SAMPLES[name]),
                    "log": f"logs/samples/{name}.log",
                    "seconds": 60 * minutes([of_row]),
                }
                for name, of_row in zip(names, sizes)
            },
        script:
            "../scripts/sample_part.py"


rule samples_summary:
    input:
        states=expand("{folder}/{sample}/state.json", folder=OWN, sample=SAMPLES),
        code=code("samples_summary.py"),
    output:
        csv=report(
            f"{OWN}/summary.csv",
            caption="../report/samples.rst",
            category="Samples",
        ),
        page=report(
            f"{OWN}/index.html",
            caption="../report/samples.rst",
            category="Samples",
        ),
        table=f"{OWN}/table.html",
    log:
        "logs/samples_summary.log",
    benchmark:
        "benchmarks/samples_summary.tsv"
    localrule: True
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=300,
    script:
        "../scripts/samples_summary.py"
