"""Studies of the paper: its multi-scale scheme, its parameters, demands, fits, and the theorem.

A study is a table in config/studies, whose cases are run in parts; `fits` and `theory` have
scripts of their own. Each ends in a tidy table, a figure, and numbers that docs/studies.md quotes.
"""

import yaml

STUDIES = "results/studies"
STUDY_TABLES = {
    path.stem: yaml.safe_load(path.read_text())
    for path in Path(settings.studies.folder).glob("*.yaml")
}
STUDIED = ["sample", "forward", "phantom", "tracking", "estimation", "tests", "preset"]
EXPERIMENT = settings.model_dump(include={*STUDIED, "identification"})
# Jobs of a minute or so; what is cut short takes less.
STUDY_PARTS = {
    name: 1 if settings.studies.values or settings.studies.cases else table["jobs"]
    for name, table in STUDY_TABLES.items()
}
STUDY_PARTS |= {"fits": settings.studies.searches, "theory": 1}


rule studies:
    input:
        expand(
            "{folder}/{name}.{kind}",
            folder=STUDIES,
            name=STUDY_PARTS,
            kind=["csv", "png", "json"],
        ),


rule study_part:
    input:
        code=code("study_part.py"),
    output:
        f"{STUDIES}/parts/{{study}}-{{part}}.csv",
    log:
        "logs/studies/{study}-{part}.log",
    benchmark:
        "benchmarks/studies/{study}-{part}.tsv"
    wildcard_constraints:
        study="|".join(STUDY_TABLES),
        part=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        table=lambda wildcards: STUDY_TABLES[wildcards.study],
        parts=lambda wildcards: STUDY_PARTS[wildcards.study],
        values=settings.studies.values,
        cases=settings.studies.cases,
        config=EXPERIMENT,
    script:
        "../scripts/study_part.py"


rule study_fits:
    input:
        code=code("study_fits.py"),
    output:
        f"{STUDIES}/parts/fits-{{part}}.csv",
    log:
        "logs/studies/fits-{part}.log",
    benchmark:
        "benchmarks/studies/fits-{part}.tsv"
    wildcard_constraints:
        part=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        evaluations=settings.studies.evaluations,
        bubbles=settings.phantom.seed,
        config=EXPERIMENT,
    script:
        "../scripts/study_fits.py"


rule study_theory:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        code=code("study_theory.py"),
    output:
        f"{STUDIES}/parts/theory-0.csv",
    log:
        "logs/studies/theory-0.log",
    benchmark:
        "benchmarks/studies/theory-0.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        values=settings.studies.values,
    script:
        "../scripts/study_theory.py"


for study, parts in STUDY_PARTS.items():

    rule:
        name:
            study
        input:
            parts=expand(
                "{folder}/parts/{study}-{part}.csv",
                folder=STUDIES,
                study=study,
                part=range(parts),
            ),
            code=code("study_figures.py"),
        output:
            csv=report(
                f"{STUDIES}/{study}.csv",
                caption=f"../report/study_{study}.rst",
                category="Studies",
                labels={"study": study, "result": "table"},
            ),
            json=f"{STUDIES}/{study}.json",
            png=report(
                f"{STUDIES}/{study}.png",
                caption=f"../report/study_{study}.rst",
                category="Studies",
                labels={"study": study, "result": "figure"},
            ),
            pdf=f"{STUDIES}/{study}.pdf",
        log:
            f"logs/studies/{study}.log",
        benchmark:
            f"benchmarks/studies/{study}.tsv"
        conda:
            "../envs/eofm.yaml"
        resources:
            mem_mb=500,
        params:
            study=study,
            config=EXPERIMENT | {"figures": settings.figures.model_dump()},
        script:
            "../scripts/study_figures.py"
